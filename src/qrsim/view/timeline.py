"""The timeline of a replay: a bar over the full width of the page, with marks of events, and keys.

viser has no such widget. The page runs a script of ours (timeline.js), which speaks to a WebSocket of its own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from importlib.resources import files

from viser import ViserServer

from qrsim.runs.layout import Event
from qrsim.view.clock import Clock
from qrsim.view.plots import Plots
from qrsim.view.script import run_script

# Of so many events a bar has no room for more; these kinds come too often to be marks.
MOST_MARKS, NO_MARKS = 300, ("waypoint_reached", "command_clipped")


class Timeline:
    """The bar of a page.

    Args:
        server: of the page.
        end: the last time [s].
        events: of the run.
        clock: says how fast it plays.
        seek: goes to a time [s], and draws everything or, while the bar is dragged, what is quick to draw.
        plots: answers wishes for lines of plots.
    """

    def __init__(
        self,
        server: ViserServer,
        end: float,
        events: list[Event],
        clock: Clock,
        seek: Callable[[float, bool], None],
        plots: Plots,
    ):
        self._server, self._end, self._clock, self._seek, self._plots = server, end, clock, seek, plots
        self._time = 0.0
        data = {"end": end, "marks": marks(events)}
        script = files("qrsim.view").joinpath("timeline.js").read_text("utf-8")
        self._run("timeline", f"window.qrsimTimeline = 1; const data = {json.dumps(data)};\n{script}")
        self._run("plots", plots_script(plots))

    def _run(self, kind: str, source: str) -> None:
        """Run the JavaScript ``source`` in all browsers, but leave it out of exported pages."""
        run_script(self._server, kind, source, exported=False)

    def show(self, time: float) -> None:
        """Move the time bar to a time [s]."""
        self._time = time
        playing = "true" if self._clock.playing else "false"
        self._run("time", f"window.qrsimTime?.({time:.6f}, {playing}, {self._clock.speed:g})")

    def wish(self, wish: object) -> bytes | None:
        """Seek, play, pause or change the speed as a browser requests; return plot lines if it requests those.

        Malformed requests are ignored.
        """
        if not isinstance(wish, dict):
            return None
        if "lines" in wish:
            return self._plots.answer(wish)
        time, clock = wish.get("time"), self._clock
        if isinstance(time, int | float) and math.isfinite(time):
            self._seek(min(max(0.0, float(time)), self._end), wish.get("drag") is not True)
        if isinstance(wish.get("play"), bool):
            clock.playing = wish["play"]
        if wish.get("faster") in (1, -1):
            nearest = min(range(len(clock.speeds)), key=lambda i: abs(clock.speeds[i] - clock.speed))
            clock.speed = clock.speeds[min(max(0, nearest + wish["faster"]), len(clock.speeds) - 1)]
        self.show(self._time)
        return None


def plots_script(plots: Plots, **more: object) -> str:
    """Return the JavaScript that draws plots, with its library and data; ``more``: further data."""
    folder = files("qrsim.view")
    scripts = ("uplot/uPlot.iife.min.js", "asking.js", "events.js", "marks.js", "words.js", "plots.js")
    library, *parts = (folder.joinpath(name).read_text("utf-8") for name in scripts)
    styles = "".join(folder.joinpath(name).read_text("utf-8") for name in ("uplot/uPlot.min.css", "plots.css"))
    data = json.dumps({**plots.about(), "css": styles, **more}).replace("<", "\\u003c")
    return "\n".join([library, f"const data = {data};", *parts])


def marks(events: list[Event]) -> list[tuple[float, str]]:
    """Return (time [s], text) of the events to mark on the timeline, evenly thinned to at most MOST_MARKS."""
    found = [(event.time, event.message or event.kind) for event in events if event.kind not in NO_MARKS]
    return found[:: math.ceil(len(found) / MOST_MARKS) or 1]
