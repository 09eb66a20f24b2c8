"""``qrsim compare``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from qrsim.apps import Repeated
from qrsim.errors import UsageError


@dataclass(frozen=True)
class Compare:
    """Compare two recorded runs: settings, headline numbers, and the logs quantity by quantity.

    Exit code: 0 if the logs are the same within the tolerance, 1 if they differ (or cannot be read), 2 for wrong usage.
    Settings (seed, versions, scenario) are printed but do not count. Ticks are matched by their time.

    One table compares the headline numbers of A and B: how each ended, tracking and estimate errors over all vehicles,
    the smallest separation, energy. The last table has a row for each quantity that differs: the first difference with
    the values in A and B, and the largest and the RMS difference over all vehicles and common ticks. The quantity that
    differs first, then most, comes first.

    Example:
      qrsim compare runs/first runs/second
      qrsim compare runs/first runs/second --tolerance 1e-4 --out difference.png
      qrsim compare runs/first runs/second --stream truth --json
    """

    run_a: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN_A")]
    """Run folder."""
    run_b: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN_B")]
    """Run folder to compare with."""
    tolerance: Annotated[float, tyro.conf.arg(metavar="X")] = 0.0
    """Floating-point values this close are the same, in the unit of each quantity; flags and counts must be equal."""
    stream: Annotated[Repeated, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: all)")] = field(
        default_factory=list
    )
    """Compare only this stream; can be given several times."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None
    """Picture to write, .png, .pdf or .svg: both plans, and the distance between the two tracks of each vehicle over
    time."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Run ``qrsim compare``: print or draw the differences of two runs; return the exit code."""
        if not (math.isfinite(self.tolerance) and self.tolerance >= 0):
            raise UsageError(f"--tolerance {self.tolerance:g}: expected a number from 0")
        from qrsim.runs import open_run
        from qrsim.runs.compare import compare_runs
        from qrsim.runs.compare_report import print_report, to_json

        first, second = (open_run(folder, skip_damaged=True) for folder in (self.run_a, self.run_b))
        found = compare_runs(first, second, self.tolerance, self.stream)
        if self.out:
            from qrsim.runs.compare_figure import draw_comparison
            from qrsim.runs.picture import save_picture

            save_picture(lambda: draw_comparison(first, second), self.out)
        if self.json:
            import json

            figure = str(self.out) if self.out else None
            print(json.dumps({**to_json(first, second, found), "figure": figure}, indent=2, allow_nan=False))
        else:
            print_report(first, second, found)
            if self.out:
                print(f"figure: {self.out}")
        return 0 if found.same else 1
