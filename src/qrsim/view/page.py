"""The page: the scene, and the panel with time, layers and sizes; what each browser has for itself is in viewers.py."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from viser import ClientHandle, ViserServer

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError
from qrsim.view.air import REACHES
from qrsim.view.clock import Clock
from qrsim.view.failing import FailingControls
from qrsim.view.frame import Cast, Frame
from qrsim.view.gate import NOTABLE_S
from qrsim.view.imagery import Imagery
from qrsim.view.loading import show_loading
from qrsim.view.markdown import plain
from qrsim.view.paint import Paint
from qrsim.view.scene import Scene
from qrsim.view.server import Delivery, listen
from qrsim.view.sky import Satellite
from qrsim.view.table import answer
from qrsim.view.viewers import Choice, Plotted, Viewer
from qrsim.world.state import World

# Status and plots are renewed at every so-many-th frame.
STATUS_FRAMES, PLOT_FRAMES = 6, 15
MOST_STOPPED = 5
BY_VEHICLE = "(vehicle)"
# Places in the panel.
# The list of stopped vehicles grows and shrinks, so it is under the time, which users type.
STATUS, TIME, STOPPED, WIND, LAYERS = 1.0, 3.0, 3.5, 5.0, 6.0


class Page:
    """The page of one world.

    Args:
        server: that it is on.
        cast: who is in it.
        world: what there is; None where that is not known.
        heading: what is shown, one line that begins with the scenario's name and a comma.
        clock: of time; None where somebody else moves it.
        imagery: picture of the ground; None: none.

    Attributes:
        scene: in which things are drawn.
        viewers: what each browser has for itself, by viser's number of it.
        time_folder: of the panel, where there is a clock.
        layers_folder: of the panel.
        drawn: number of frames.
        dropped: returns how many frames were not drawn, because newer ones were there already.
        note: what the panel says about the run as a whole, one line; "": nothing.
        sky: returns the satellites of a vehicle as its receiver last said.
        plotted: returns for a vehicle and a measured quantity its (times, measured, true), each (K,).
        failing: adds to a browser's panel what lets parts of its chosen vehicle fail; None: nothing can.
        stops: vehicle -> time at which it stopped [s], for the table; None: when a frame first shows that it has.
        paused: called after a user has paused the clock by a button.
        wishes: handles requests of browsers' scripts that are neither for the table nor a choice in it.
    """

    def __init__(
        self,
        server: ViserServer,
        cast: Cast,
        world: World | None,
        heading: str,
        clock: Clock | None,
        imagery: Imagery | None = None,
    ):
        self.server, self.heading, self.clock = server, heading, clock
        title = heading.partition(",")[0]
        server.gui.set_panel_label(f"qrsim - {title}")
        server.gui.main_panel.dock_right()
        show_loading(server, heading)
        self.scene = Scene(server, cast, world, title, imagery)
        self.dropped: Callable[[], int] = lambda: 0
        self.plotted: Plotted | None = None
        self.sky: Callable[[int], list[Satellite]] = lambda vehicle: []
        self.scene.stage.sky = self._sky_now
        self.failing: Callable[[Any], FailingControls] | None = None
        self.viewers: dict[int, Viewer] = {}
        self.stops: dict[int, float] | None = None
        self._seen_stopped: dict[int, float] = {}
        self.paused: Callable[[], None] = lambda: None
        self.wishes: Callable[[Any], bytes | None] = lambda wish: None
        listen(server, self.wish)
        self.drawn = 0
        self.note = ""
        self._quantities: list[str] = []
        # Of browsers that come later.
        self._choice = Choice()
        self._choices: dict[int, Choice] = {}
        self._lock = threading.RLock()
        self._open = True
        self._colour: Any = None
        self._delivery = Delivery(server)
        self.scene.lag_s = lambda: self._delivery.lag_s
        self._status = server.gui.add_markdown("", order=STATUS)
        self._stopped = server.gui.add_markdown("", order=STOPPED)
        if clock is not None:
            self._add_clock(clock)
        self._add_layers()
        self.scene.vehicles.on_click(self._clicked)
        server.on_client_connect(self._come)
        server.on_client_disconnect(self._gone)

    @property
    def chosen(self) -> frozenset[int]:
        """Numbers of the vehicles chosen in any browser, or by default in new ones."""
        with self._lock:
            every = [self._choice, *(viewer.choice for viewer in self.viewers.values())]
        return frozenset(choice.vehicle for choice in every if choice.vehicle is not None)

    # ---- browsers ----

    def _come(self, client: ClientHandle) -> None:
        """Add the controls of a newly connected browser, restoring its earlier choice of vehicle."""
        with self._lock:
            if not self._open:
                return
            choice = self._choices.pop(client.client_id, self._choice)
            self.viewers[client.client_id] = Viewer(
                client,
                self.scene,
                choice,
                self._quantities,
                self._plotted_now,
                self._chosen_now,
                self._sky_now,
                self.failing,
            )
        self._chosen_now()

    def _gone(self, client: ClientHandle) -> None:
        """Remove the controls of a browser that has disconnected."""
        with self._lock:
            self.viewers.pop(client.client_id, None)
        if self._open:
            self._chosen_now()

    def _plotted_now(self, vehicle: int, quantity: str) -> tuple[Floats, Floats, Floats]:
        """Return times [s], readings and true values of a vehicle's quantity to plot; empty arrays without any."""
        nothing = (np.zeros(0),) * 3
        return nothing if self.plotted is None else self.plotted(vehicle, quantity)

    def _sky_now(self, vehicle: int) -> list[Satellite]:
        """Return the satellites that a vehicle's GNSS receiver reports now."""
        return self.sky(vehicle)

    def _chosen_now(self) -> None:
        """Mark the vehicles in the scene that any browser has chosen."""
        self.scene.choose(*self.chosen)

    def _clicked(self, vehicle: int | None, event: Any) -> None:
        """Choose the clicked vehicle, or the one nearest to the click's ray, in the browser of the click."""
        viewer = self.viewers.get(event.client_id)
        if viewer is not None:
            by_ray = vehicle is None
            viewer.choose(self.scene.nearest(event.ray_origin, event.ray_direction) if by_ray else vehicle)

    def wish(self, wish: Any) -> bytes | None:
        """Answer a browser's request for the table of vehicles, a choice in it, or what ``wishes`` answers.

        Malformed requests are ignored.
        """
        if isinstance(wish, dict) and wish.get("table") is True:
            exact = self.stops is not None
            stops = self._seen_stopped if self.stops is None else self.stops
            frame = self.scene.frame
            return answer(wish, frame, self.scene.cast.waypoints, stops, exact)
        if isinstance(wish, dict) and "choose" in wish:
            vehicle, browser = wish["choose"], wish.get("browser")
            viewer = self.viewers.get(browser) if isinstance(browser, int) else None
            known = vehicle is None or (type(vehicle) is int and 0 <= vehicle < self.scene.cast.size)
            if viewer is not None and known:
                viewer.choose(vehicle)
            return None
        return self.wishes(wish)

    def choose(self, vehicle: int | None) -> None:
        """Choose a vehicle (None: no vehicle) in all browsers, and in those that connect later."""
        self._choice.vehicle = vehicle
        for viewer in list(self.viewers.values()):
            viewer.choose(vehicle)
        self._chosen_now()

    def follow(self, follow: bool = True) -> None:
        """Follow the chosen vehicle with the camera in all browsers, and in those that connect later."""
        self._choice.follow = follow
        for viewer in list(self.viewers.values()):
            viewer.follow(follow)

    def adopt(self, other: Page) -> None:
        """Take over choices and visible layers from another page that shows the same vehicles."""
        for title, layer in other.scene.layers.items():
            if title in self.scene.layers and layer.root.visible != self.scene.layers[title].root.visible:
                self._shown[title].value = layer.root.visible
                self.scene.show(title, layer.root.visible)
        colours = (self._colour, other._colour)
        if all(colours) and other._colour.value in self._colour.options:
            self._colour.value = other._colour.value
        if self._air is not None and other._air is not None:
            for mine, theirs in zip(self._air, other._air, strict=True):
                mine.value = theirs.value
            self.scene.show_air(*(own.value for own in self._air))
        self._choice = other._choice
        with self._lock:
            self._choices = {number: viewer.choice for number, viewer in other.viewers.items()}
            here = [
                (self.viewers[number], choice) for number, choice in self._choices.items() if number in self.viewers
            ]
        for viewer, choice in here:
            viewer.follow(choice.follow)
            viewer.choose(choice.vehicle)
        self._chosen_now()

    def close(self) -> None:
        """Remove this page's content, so that another page can use the same server."""
        with self._lock:
            self._open = False
        for calls, own in (
            (self.server._client_connect_cb, self._come),
            (self.server._client_disconnect_cb, self._gone),
        ):
            with suppress(ValueError):
                calls.remove(own)

    # ---- the panel ----

    def _add_clock(self, clock: Clock) -> None:
        """Add the buttons play, pause and step and the menu of speeds to the panel."""
        gui = self.server.gui
        self.time_folder = gui.add_folder("Time", order=TIME)
        with self.time_folder:
            buttons = gui.add_button_group("Run", ("play", "pause", "step"))
            speed = gui.add_dropdown(
                "Speed", [_speed_name(s) for s in clock.speeds], initial_value=_speed_name(clock.speed)
            )

        @buttons.on_click
        def _(_: object) -> None:
            """Step, play or pause the clock as clicked, and update the text of the shown frame."""
            if buttons.value == "step":
                clock.step()
            else:
                clock.playing = buttons.value == "play"
            # What is drawn from now on says so itself; this is for what was drawn before.
            if self.scene.frame is not None:
                self._say(self.scene.frame)
            if buttons.value == "pause":
                self.paused()

        @speed.on_update
        def _(_: object) -> None:
            """Set the clock's speed to the one selected in the menu."""
            clock.speed = next(s for s in clock.speeds if _speed_name(s) == speed.value)

    def _add_layers(self) -> None:
        """Add a checkbox for each layer to the panel, and a slider for the size of vehicles."""
        gui, stage = self.server.gui, self.scene.stage
        self._shown: dict[str, Any] = {}
        self.layers_folder = gui.add_folder("Layers", order=LAYERS)
        with self.layers_folder:
            largest = max(40.0, round(4.0 * stage.span))
            size = gui.add_slider("Size [m]", 0.5, largest, 0.5, max(0.5, _half(stage.span)), hint="of drawn vehicles")
            true = gui.add_checkbox("True size", False, hint=f"vehicles of {stage.cast.true_span:.2g} m")
            for title, layer in self.scene.layers.items():
                self._shown[title] = gui.add_checkbox(title, layer.root.visible)
                self._shown[title].on_update(partial(self._show, title))
            self._add_air()

        def resize(_: object) -> None:
            """Scale the vehicles as the slider and the checkbox are set."""
            size.disabled = true.value
            self.scene.resize(stage.cast.true_span if true.value else size.value)

        size.on_update(resize)
        true.on_update(resize)

    def _add_air(self) -> None:
        """Add controls for the height and kind of the wind arrows to the panel, if the world has such a layer."""
        layer, gui = self.scene.air, self.server.gui
        self._air: tuple[Any, Any] | None = None
        if layer is None:
            return
        height = gui.add_slider("Air at [m]", 1.0, layer.highest, 1.0, layer.height, hint="height over the origin")
        shows = gui.add_dropdown("Air", list(REACHES), initial_value=layer.shows)
        self._air = (height, shows)

        def change(_: object) -> None:
            """Show the wind arrows at the height and of the kind that are set."""
            self.scene.show_air(height.value, shows.value)

        height.on_update(change)
        shows.on_update(change)

    def add_plots(self, quantities: list[str]) -> None:
        """Let users plot readings of the vehicle they have chosen, together with the true values."""
        with self._lock:
            self._quantities = quantities
            for number, viewer in list(self.viewers.items()):
                client = self.server.get_clients().get(number)
                if client is not None:
                    self._choices[number] = viewer.choice
                    self._come(client)

    def add_colours(self, names: list[str], paint: Callable[[str], Paint], chosen: str | None = None) -> None:
        """Add a menu of quantities ``names``, at first ``chosen``; ``paint(name)`` colours vehicles and true paths."""
        with self.layers_folder:
            by = self.server.gui.add_dropdown(
                "Colour", (BY_VEHICLE, *names), initial_value=chosen or BY_VEHICLE, hint="of vehicles and true paths"
            )

        def change(_: object) -> None:
            """Colour the scene by the selected quantity, or show why it cannot be read from the log."""
            try:
                self.scene.colour(None if by.value == BY_VEHICLE else paint(by.value))
            except QrsimError as error:
                self.say(str(error))

        by.on_update(change)
        self._colour = by
        if chosen is not None:
            self.scene.colour(paint(chosen))

    # ---- what happens ----

    def _show(self, title: str, event: Any) -> None:
        """Show or hide the layer with this title, as its checkbox was set."""
        self.scene.show(title, event.target.value)

    def say(self, note: str) -> None:
        """Show one line of text about the whole run in the panel."""
        self.note = note
        if self.scene.frame is not None:
            self._say(self.scene.frame)

    def draw(self, frame: Frame, everything: bool = False) -> None:
        """Draw a frame and update the panel; ``everything``: also layers that are slow to draw."""
        self.scene.draw(frame, everything)
        if len(frame.reasons) != len(self._seen_stopped):
            self._seen_stopped = {i: self._seen_stopped.get(i, frame.time) for i in frame.reasons}
        # Who pauses after this says what is drawn by now.
        paused = self.clock is not None and not self.clock.playing
        if everything or paused or self.drawn % STATUS_FRAMES == 0:
            self._say(frame)
        if everything or self.drawn % PLOT_FRAMES == 0:
            here = self.server.get_clients()
            for viewer in [viewer for number, viewer in list(self.viewers.items()) if number in here]:
                viewer.plot()
                viewer.send_sky()
        self.drawn += 1
        self._delivery.sent()

    def _say(self, frame: Frame) -> None:
        """Write time, number of flying vehicles, dropped frames and stopped vehicles of a frame into the panel."""
        stopped = f", {len(frame.reasons)} stopped" if frame.reasons else ""
        fliers = self.scene.cast.fliers
        flying = f"{int((frame.valid & fliers).sum())} of {int(fliers.sum())} vehicles fly{stopped}"
        flying += f", {self.scene.cast.others}" if self.scene.cast.others else ""
        paused = "" if self.clock is None or self.clock.playing else " (paused)"
        frames = f"{self.drawn} frames drawn, {self.dropped() + self._delivery.missed} dropped"
        if (lag := self._delivery.lag_s) > NOTABLE_S:
            frames = f"**slow link: {lag:.1f} s behind**"
        note = f"{plain(self.note)}  \n" if self.note else ""
        heading, time = f"**{plain(self.heading)}**", f"**t = {frame.time:.2f} s**{paused}"
        self._status.content = f"{heading}  \n{note}{time}  \n{flying}  \n{frames}"
        names = self.scene.cast.names
        lines = [f"- **{plain(names[i])}** {plain(why)}" for i, why in list(frame.reasons.items())[:MOST_STOPPED]]
        if len(frame.reasons) > MOST_STOPPED:
            lines.append(f"- and {len(frame.reasons) - MOST_STOPPED} more")
        self._stopped.content = "\n".join(lines)


def _speed_name(speed: float) -> str:
    """Return the label of a playback speed in the page's menu."""
    return "as fast as can be" if math.isinf(speed) else f"{speed:g} x"


def _half(value: float) -> float:
    """Return a value rounded to a multiple of 0.5."""
    return round(2.0 * value) / 2.0
