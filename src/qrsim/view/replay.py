"""A page that plays a recorded run."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np

from qrsim.view.clock import FRAME_S, SPEEDS, Clock
from qrsim.view.page import Page
from qrsim.view.plots import Plots
from qrsim.view.recording import Recording
from qrsim.view.scene import Scene
from qrsim.view.several import Several
from qrsim.view.timeline import Timeline

# The slider is moved at every so-many-th frame.
SLIDER_FRAMES = 5


class Replay:
    """Plays a recording.

    Args:
        recording: what is shown.
        page: where; its clock says how fast.
        time: to begin at [s].
        colour: quantity that colours vehicles and true paths at first; None: none does.

    Attributes:
        time: simulated time that is shown [s].
    """

    def __init__(
        self,
        recording: Recording | Several,
        page: Page,
        clock: Clock,
        time: float = 0.0,
        colour: str | None = None,
    ):
        self.recording, self.page, self.clock = recording, page, clock
        self.time = time
        self._lock = threading.Lock()
        end = recording.end
        step = max(0.01, round(end / 2000.0, 2))
        with page.time_folder:
            self._slider: Any = page.server.gui.add_slider("t [s]", 0.0, max(end, step), step, min(time, end))
        self._slider.on_update(self._scrub)
        self._timeline = Timeline(page.server, end, recording.events, clock, self.seek, Plots(recording))
        page.wishes, page.paused = self._wish, self._paused
        page.stops = {vehicle: event.time for event, vehicle in recording.stops}
        page.note = page.note or " / ".join(recording.notes)
        page.sky = lambda vehicle: recording.sky(vehicle, self.time)
        page.add_colours(recording.paints.names, recording.paints.of, colour)
        self.seek(time)

    def _scrub(self, event: Any) -> None:
        """Go to the time of the slider that a user has moved."""
        # What the program itself moved has no client.
        if event.client is not None:
            self.seek(self._slider.value)

    def _wish(self, wish: object) -> bytes | None:
        """Seek, play, pause or change the speed as a browser requests; return plot lines if it requests those."""
        played = self.clock.playing
        answer = self._timeline.wish(wish)
        if played and not self.clock.playing:
            self._paused()
        return answer

    def _paused(self) -> None:
        """Show the present time in panel, slider and timeline, which follow only some frames while it plays."""
        self.seek(self.time)

    def seek(self, time: float, everything: bool = True) -> None:
        """Go to a time [s]; without ``everything``, layers that are slow to draw follow some frames later."""
        with self._lock:
            self.time = min(max(0.0, time), self.recording.end)
            self._show(everything)

    def _show(self, everything: bool = False) -> None:
        """Draw the frame at the present time; ``everything``: also move the slider and draw slow layers."""
        frame = self.recording.frame(self.time)
        remember_paths(self.page.scene, self.recording, frame.time)
        self.page.draw(frame, everything)
        if everything or self.page.drawn % SLIDER_FRAMES == 0:
            # What a user types there is not written again, over the next digit.
            if self._slider.value != self.time:
                self._slider.value = self.time
            self._timeline.show(self.time)

    def run(self, stop: threading.Event) -> None:
        """Play in real time until ``stop`` is set and the clock is closed; at the end start again."""
        times = self.recording.time
        step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
        most = math.ceil(2.0 * SPEEDS[-2] * FRAME_S / step)
        while not stop.is_set():
            count = self.clock.wait(step, most)
            if stop.is_set():
                return
            with self._lock:
                self.time = count * step if self.time >= self.recording.end else self.time + count * step
                ended = self.time >= self.recording.end
                self.time = min(self.time, self.recording.end)
                if ended:
                    self.clock.playing = False
                self._show(everything=ended or not self.clock.playing)


def remember_paths(scene: Scene, recording: Recording | Several, time: float) -> None:
    """Extend the paths drawn in a scene to a time [s], with recorded positions; after a jump, draw them again."""
    for paths, read in zip(scene.paths, (recording.positions, recording.estimates), strict=True):
        times = paths.missing(time)
        if len(times):
            paths.extend(times, read(times))
