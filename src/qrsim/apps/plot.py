"""``qrsim plot``."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import OPTIONAL_SECONDS, Repeated
from qrsim.errors import UsageError

if TYPE_CHECKING:
    from qrsim.runs import Run

FIGURE, PANELS = "figure.png", "panels.png"
# In place of a quantity: the satellites over a vehicle.
SKY = "sky"
# A panel that is no quantity: errors of the estimate within what its estimator says of them.
ESTIMATE = "estimate"
# Neither: who hears whom over the radio.
RADIO = "radio"
_Seconds = Annotated[float | None, OPTIONAL_SECONDS, tyro.conf.arg(help_behavior_hint="(default: the whole run)")]


@dataclass(frozen=True)
class Plot:
    """Draw a recorded run: plan view, height, GNSS error and wind, or any logged quantities over time.

    Works on running, interrupted and killed runs too, up to the last flush. A quantity is STREAM.COLUMN, or the name
    of a vector without its axis; --list shows them all.

    Example:
      qrsim plot runs/first
      qrsim plot runs/first --list
      qrsim plot runs/first --panel sky --vehicle scout
      qrsim plot runs/swarm --panel radio --from 10
      qrsim plot runs/first --panel truth.position_ned.z --panel wind.gust_ned --out first.pdf
      qrsim plot runs/first --panel "measurements.gnss.position_ned.x, truth.position_ned.x" --from 5 --to 15
    """

    run_folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Run folder."""
    panel: Annotated[Repeated, tyro.conf.arg(metavar="QUANTITY[,QUANTITY...]")] = field(default_factory=list)
    """Draw these quantities, of one unit, in a panel; a vector gets a panel for each axis. Repeat the option for more
    panels. 'sky' draws the sky over a vehicle whose receiver has per_satellite: true; 'estimate' the errors of the
    estimate, with 3 std; 'radio' the radio links, delivery and connectivity."""
    vehicle: Annotated[Repeated, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: all)")] = field(
        default_factory=list
    )
    """Draw only this vehicle in the panels; can be given several times."""
    start: Annotated[_Seconds, tyro.conf.arg(name="from")] = None
    """Begin of the panels."""
    end: Annotated[_Seconds, tyro.conf.arg(name="to")] = None
    """End of the panels."""
    out: Annotated[
        Path | None,
        tyro.conf.arg(
            aliases=["-o", "--output"],
            metavar="FILE",
            help_behavior_hint=f"(default: RUN/{FIGURE}, with --panel RUN/{PANELS})",
        ),
    ] = None
    """Picture to write: .png, .pdf or .svg."""
    show: Annotated[bool, tyro.conf.arg(name="list")] = False
    """Print all quantities with unit and meaning, and draw nothing."""
    code: bool = False
    """Load the Python files and modules that the recorded scenario names; only if you trust its author."""
    json: bool = False
    """Print the quantities, or the path of the picture, as JSON."""

    def run(self) -> None:
        """Run ``qrsim plot``: check the options, draw the figure, and print its path."""
        self._check()
        from qrsim.runs import open_run

        recorded = open_run(self.run_folder, code=self.code)
        if recorded.unfinished:
            print(recorded.unfinished, file=sys.stderr)
        if self.show:
            _print_quantities(recorded, self.json)
            return
        path = self.out or self.run_folder / (PANELS if self.panel else FIGURE)
        self._draw(recorded, path)
        if self.json:
            import json

            print(json.dumps({"run": str(self.run_folder), "figure": str(path)}, indent=2))
        else:
            print(path)

    def _check(self) -> None:
        """Raise UsageError for options that are out of range or do not go together."""
        given = {"--vehicle": self.vehicle, "--from": self.start, "--to": self.end}
        alone = [option for option, value in given.items() if value not in (None, [])]
        if alone and not self.panel:
            raise UsageError(f"{', '.join(alone)}: only for panels; add --panel, for example truth.position_ned.z")
        if SKY in self.panel and len(self.panel) > 1:
            raise UsageError(f"--panel {SKY} is a separate picture; leave out the other panels")
        if self.show and (self.panel or self.out):
            raise UsageError("--list draws nothing: leave out --panel and --out")
        for option, time in (("--from", self.start), ("--to", self.end)):
            if time is not None and not math.isfinite(time):
                raise UsageError(f"{option} {time:g}: expected a number of seconds")
        if self.start is not None and self.end is not None and self.start > self.end:
            raise UsageError(f"--from {self.start:g} is after --to {self.end:g}")

    def _draw(self, recorded: Run, path: Path) -> None:
        """Draw and save the figure that the options choose: overview, sky, estimate, radio or panels."""
        if not self.panel:
            from qrsim.runs.figure import save_figure

            save_figure(recorded, path)
            return
        from qrsim.runs.picture import save_picture

        if SKY in self.panel:
            from qrsim.runs.sky_plot import draw_sky

            save_picture(lambda: draw_sky(recorded, self.vehicle, self.start, self.end), path)
            return
        if ESTIMATE in self.panel:
            from qrsim.runs.estimate_figure import draw_estimate

            if len(self.panel) > 1:
                raise UsageError(f"--panel {ESTIMATE} is a separate figure; leave out the other panels")
            save_picture(lambda: draw_estimate(recorded, self.vehicle, self.start, self.end), path)
            return
        if RADIO in self.panel:
            from qrsim.runs.radio_figure import draw_radio

            if len(self.panel) > 1:
                raise UsageError(f"--panel {RADIO} is a separate figure; leave out the other panels")
            save_picture(lambda: draw_radio(recorded, self.vehicle, self.start, self.end), path)
            return
        from qrsim.runs.panels import draw_panels

        save_picture(lambda: draw_panels(recorded, self.panel, self.vehicle, self.start, self.end), path)


def _print_quantities(recorded: Run, as_json: bool) -> None:
    """Print the quantities that a run recorded, with unit and meaning, as a table or JSON."""
    from qrsim.runs.quantities import quantities

    found = quantities(recorded)
    if as_json:
        import json

        rows = [{"quantity": item.name, "unit": item.column.unit, "doc": item.column.doc} for item in found]
        print(json.dumps(rows, indent=2, ensure_ascii=False))
        return
    width = max(len(item.name) for item in found)
    units = max(len(item.column.unit) for item in found)
    for item in found:
        print(f"{item.name:<{width}}  {item.column.unit:<{units}}  {item.column.doc}".rstrip())
    print("\nA name without its last part, such as truth.position_ned, means all axes. Time is in s.")
