"""The page: the scene, and the panel with time, layers, the chosen vehicle and its plot."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from viser import ViserServer

from qrsim.view.cameras import Cameras
from qrsim.view.clock import Clock
from qrsim.view.frame import Cast, Frame
from qrsim.view.gate import NOTABLE_S
from qrsim.view.layers import STRONG_WIND
from qrsim.view.scene import Scene
from qrsim.view.server import Delivery
from qrsim.world.state import World

Floats = np.ndarray[Any, Any]
NOBODY = "(nobody)"
# Status and plots are renewed at every so-many-th frame; a plot has at most so many points.
STATUS_FRAMES, PLOT_FRAMES, MOST_POINTS = 6, 15, 300
MOST_STOPPED = 10
PLOTS = 2


class Page:
    """The page of one world.

    Args:
        server: that it is on.
        cast: who is in it.
        world: what there is; None where that is not known.
        heading: what is shown, one line.
        clock: of time; None where somebody else moves it.

    Attributes:
        scene: in which things are drawn.
        time_folder: of the panel, where there is a clock.
        drawn: number of frames.
        dropped: returns how many frames were not drawn, because newer ones were there already.
        note: what the panel says about the run as a whole, one line; "": nothing.
        plotted: returns for a vehicle and a measured quantity its (times, measured, true), each (K,).
        quantities: what can be plotted.
    """

    def __init__(self, server: ViserServer, cast: Cast, world: World | None, heading: str, clock: Clock | None):
        self.server, self.heading, self.clock = server, heading, clock
        self.scene = Scene(server, cast, world)
        self.dropped: Callable[[], int] = lambda: 0
        self.plotted: Callable[[int, str], tuple[Floats, Floats, Floats]] | None = None
        self.drawn = 0
        self.note = ""
        self._delivery = Delivery(server)
        self.scene.lag_s = lambda: self._delivery.lag_s
        self._status = server.gui.add_markdown("")
        self._stopped = server.gui.add_markdown("")
        if clock is not None:
            self._add_clock(clock)
        self._add_vehicle()
        self._add_layers()
        self.scene.vehicles.on_click(self._clicked)

    @property
    def chosen(self) -> int | None:
        """Index of the plotted vehicle, None if there is none."""
        return self.scene.stage.chosen

    # ---- the panel ----

    def _add_clock(self, clock: Clock) -> None:
        gui = self.server.gui
        self.time_folder = gui.add_folder("Time")
        with self.time_folder:
            buttons = gui.add_button_group("Run", ("play", "pause", "step"))
            speed = gui.add_dropdown(
                "Speed", [_speed_name(s) for s in clock.speeds], initial_value=_speed_name(clock.speed)
            )

        @buttons.on_click
        def _(_: Any) -> None:
            if buttons.value == "step":
                clock.step()
            else:
                clock.playing = buttons.value == "play"
            # What is drawn from now on says so itself; this is for what was drawn before.
            if self.scene.frame is not None:
                self._say(self.scene.frame)

        @speed.on_update
        def _(_: Any) -> None:
            clock.speed = next(s for s in clock.speeds if _speed_name(s) == speed.value)

    def _add_vehicle(self) -> None:
        gui, names = self.server.gui, self.scene.cast.names
        self._vehicle_folder = gui.add_folder("Vehicle")
        with self._vehicle_folder:
            self._who: Any = gui.add_dropdown("Name", (NOBODY, *names), hint="or click a vehicle")
            self._follow: Any = gui.add_checkbox("Follow", False)
            self._size = gui.add_slider("Size [m]", 0.5, 40.0, 0.5, _half(self.scene.stage.span))
        self._plots: list[tuple[Any, Any]] = []

        @self._who.on_update
        def _(_: Any) -> None:
            self.choose(None if self._who.value == NOBODY else names.index(self._who.value))

        @self._follow.on_update
        def _(_: Any) -> None:
            self.scene.follow(self.chosen if self._follow.value else None)

        @self._size.on_update
        def _(_: Any) -> None:
            self.scene.resize(self._size.value)

    def _add_layers(self) -> None:
        gui = self.server.gui
        self._shown: dict[str, Any] = {}
        with gui.add_folder("Layers", expand_by_default=False):
            for title, layer in self.scene.layers.items():
                self._shown[title] = gui.add_checkbox(title, layer.root.visible)
                self._shown[title].on_update(partial(self._show, title))
            gui.add_markdown(f"Wind: the darker the stronger, to {STRONG_WIND:g} m/s; gusts are brown. Stopped: red.")
            if Cameras.title in self.scene.layers:
                gui.add_markdown("Camera pictures: yellow speaks for a person, blue against.")

    def add_plots(self, quantities: list[str]) -> None:
        """Add plots of the chosen vehicle's measurements against the truth."""
        gui = self.server.gui
        series = ({"label": "t"}, {"label": "measured", "stroke": "#d62728"}, {"label": "true", "stroke": "#1f77b4"})
        with self._vehicle_folder:
            for number in range(min(PLOTS, len(quantities))):
                choice = gui.add_dropdown("Reading", quantities, initial_value=_first_choice(quantities, number))
                # Some times, because a plot that begins without any never finds its scale.
                empty = (np.array([0.0, 1.0]), *(np.full(2, np.nan),) * 2)
                plot = gui.add_uplot(empty, series, scales={"x": {"time": False}}, height=150)  # type: ignore[arg-type]
                self._plots.append((choice, plot))
                choice.on_update(lambda _: self._plot())

    # ---- what happens ----

    def _clicked(self, vehicle: int | None, event: Any) -> None:
        by_ray = vehicle is None
        self.choose(self.scene.nearest(event.ray_origin, event.ray_direction) if by_ray else vehicle)

    def _show(self, title: str, event: Any) -> None:
        self.scene.show(title, event.target.value)

    def choose(self, vehicle: int | None) -> None:
        """Plot a vehicle, and follow it if following is switched on."""
        self.scene.choose(vehicle)
        name = NOBODY if vehicle is None else self.scene.cast.names[vehicle]
        if self._who.value != name:
            self._who.value = name
        if self._follow.value or self.scene.followed is not None:
            self.scene.follow(vehicle)
        self._plot()

    def adopt(self, other: Page) -> None:
        """Take over what was chosen, followed and shown on another page of the same vehicles."""
        for title, layer in other.scene.layers.items():
            if title in self.scene.layers and layer.root.visible != self.scene.layers[title].root.visible:
                self._shown[title].value = layer.root.visible
                self.scene.show(title, layer.root.visible)
        self._follow.value = other.scene.followed is not None
        if other.chosen is not None:
            self.choose(other.chosen)

    def say(self, note: str) -> None:
        """Say something about the run as a whole, one line."""
        self.note = note
        if self.scene.frame is not None:
            self._say(self.scene.frame)

    def draw(self, frame: Frame, everything: bool = False) -> None:
        """Show a frame."""
        self.scene.draw(frame, everything)
        if everything or self.drawn % STATUS_FRAMES == 0:
            self._say(frame)
        if everything or self.drawn % PLOT_FRAMES == 0:
            self._plot()
        self.drawn += 1
        self._delivery.sent()

    def _say(self, frame: Frame) -> None:
        stopped = f", {len(frame.reasons)} stopped" if frame.reasons else ""
        flying = f"{int(frame.valid.sum())} of {len(frame.valid)} vehicles fly{stopped}"
        paused = "" if self.clock is None or self.clock.playing else " (paused)"
        frames = f"{self.drawn} frames drawn, {self.dropped() + self._delivery.missed} dropped"
        if (lag := self._delivery.lag_s) > NOTABLE_S:
            frames += f"  \n**slow link: {lag:.1f} s behind**"
        note = f"{self.note}  \n" if self.note else ""
        self._status.content = f"**{self.heading}**  \n{note}**t = {frame.time:.2f} s**{paused}  \n{flying}  \n{frames}"
        names = self.scene.cast.names
        lines = [f"- {names[i]}: {why}" for i, why in list(frame.reasons.items())[:MOST_STOPPED]]
        if len(frame.reasons) > MOST_STOPPED:
            lines.append(f"- and {len(frame.reasons) - MOST_STOPPED} more")
        self._stopped.content = "\n".join(lines)

    def _plot(self) -> None:
        if self.chosen is None or self.plotted is None:
            return
        for choice, plot in self._plots:
            found = self.plotted(self.chosen, choice.value)
            if len(found[0]) > 1:
                every = math.ceil(len(found[0]) / MOST_POINTS)
                # The newest is always one of them.
                plot.data = tuple(values[::-every][::-1].astype(np.float64) for values in found)


def _speed_name(speed: float) -> str:
    return "as fast as can be" if math.isinf(speed) else f"{speed:g} x"


def _half(value: float) -> float:
    return round(2.0 * value) / 2.0


def _first_choice(quantities: list[str], number: int) -> str:
    """Return the initial quantity of a plot: one with instructive errors, if it is measured."""
    wanted = ("position_ned.x", "height")
    return next((q for q in quantities if q.endswith(wanted[number])), quantities[number])
