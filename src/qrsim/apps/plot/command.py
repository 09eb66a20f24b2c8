"""``qrsim plot``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Plot:
    """Draw the figure of a recorded run: plan view, height, GNSS error, wind.

    Works on running, interrupted and killed runs too, up to the last flush.

    Example:
      qrsim plot runs/first
      qrsim plot runs/first -o first.pdf
    """

    run_folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Run folder."""
    output: Annotated[
        Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE", help_behavior_hint="(default: RUN/figure.png)")
    ] = None
    """Picture to write: .png, .pdf or .svg."""

    def run(self) -> None:
        """Draw and say where the picture is."""
        from qrsim.logs import open_run
        from qrsim.logs.figure import save_figure

        path = self.output or self.run_folder / "figure.png"
        save_figure(open_run(self.run_folder), path)
        print(path)
