"""``qrsim replay``."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Replay:
    """Fly a recorded world of several controllers again, without them, and compare.

    Injections of the recorded flight (injections.yaml) are repeated. Checks that all streams are bit-identical. Takes a
    run that 'qrsim mavlink', 'qrsim ros2' or 'qrsim serve SCENARIO --pace free' (or barrier) has recorded with
    '--record DIR'. Its stream 'orders' has the order of each vehicle in each tick. Exit code: 0 if everything is the
    same, 1 if something differs (or cannot be read), 2 for wrong usage.

    Example:
      qrsim replay runs/served/SESSION/episode-0001
      qrsim replay runs/served/SESSION/episode-0001 --out runs/again
    """

    run_folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Run folder."""
    out: Annotated[
        Path | None, tyro.conf.arg(aliases=["-o"], metavar="DIR", help_behavior_hint="(default: not kept)")
    ] = None
    """Run folder for the new flight."""
    code: bool = False
    """Load the Python files and modules that the recorded scenario names; only if you trust its author."""

    def run(self) -> int:
        """Run ``qrsim replay``: fly a run again, compare it with the recording, print differences; return the exit
        code."""
        from qrsim.links.shared.replay import replay
        from qrsim.runs import open_run
        from qrsim.runs.compare import compare_runs
        from qrsim.runs.compare_report import print_report

        recorded = open_run(self.run_folder, code=self.code)
        with tempfile.TemporaryDirectory(prefix="qrsim-replay-") as folder:
            again = open_run(replay(recorded, self.out or Path(folder) / "again"))
            # Events of the controllers themselves are not there again.
            streams = [name for name in recorded.streams if name != "events"]
            found = compare_runs(recorded, again, 0.0, streams)
            if found.same:
                vehicles = len(recorded.vehicles)
                print(f"{recorded.info.ticks} ticks of {vehicles} vehicle{'s' * (vehicles != 1)}: the same to the bit")
            else:
                print_report(recorded, again, found)
        if self.out:
            print(f"run: {self.out}")
        return 0 if found.same else 1
