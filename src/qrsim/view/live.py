"""A page of a simulation that runs: it gets what there is to see, and never keeps the simulation waiting."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from qrsim.core.tree import walk
from qrsim.simulation import History, Simulation
from qrsim.view.clock import FRAME_S, Clock
from qrsim.view.frame import Frame, cast_of, frame_of
from qrsim.view.page import Page
from qrsim.view.server import address, start_server
from qrsim.view.steering import Wind, change_wind, wind_of
from qrsim.view.truth import true_values
from qrsim.world_tree import State, World

Floats = np.ndarray[Any, Any]
# How many values a plot keeps: a minute, at every frame.
MOST_VALUES = 1800
# Returns the state to show, time first; called in the page's thread.
Look = Callable[[], tuple[State, int]]


class LiveView:
    """Shows a simulation.

    The simulation's thread calls ``begin`` once, then ``offer`` as often as it likes; one of the page's own draws the
    newest of what was offered, 30 times a second.

    Args:
        port: to listen on; where it is taken, the next free one.
        clock: by which the simulation goes; None where it goes by another.

    Attributes:
        address: to open in a browser.
    """

    def __init__(self, port: int, clock: Clock | None = None):
        self.clock = clock
        self._server = start_server(port)
        self.address = address(self._server)
        self._newest: Look | None = None
        self._there = threading.Condition()
        self._last = 0.0
        self._closed = False
        self._page: Page | None = None
        self._thread: threading.Thread | None = None
        self._overtaken = 0
        self._wished: Wind | None = None
        self._values: deque[tuple[float, dict[str, float], dict[str, float]]] = deque(maxlen=MOST_VALUES)
        self._kept: int | None = None

    def begin(self, simulation: Simulation, heading: str) -> None:
        """Show another world from here on; one that was shown before goes."""
        self._end_drawing()
        self._server.gui.reset()
        self._server.scene.reset()
        world = simulation.world
        page = Page(self._server, cast_of(world, simulation.truth.position_ned), world, heading, self.clock)
        page.dropped = lambda: self._overtaken
        page.plotted = self._plotted
        page.add_plots(list(_measured(simulation.state, world, 0)))
        self._add_wind(page, world)
        self._page, self._world, self._step_s = page, world, world.time_step
        self._values.clear()
        self._thread = threading.Thread(target=self._draw_all, name="view", daemon=True)
        self._closed = False
        self.offer(simulation.history)
        self._thread.start()

    def wait(self, most: int) -> int:
        """Return how many ticks, up to ``most``, to fly next; waits while the page is paused or ahead of its speed."""
        return most if self.clock is None else self.clock.wait(self._step_s, most)

    def offer(self, history: History, always: bool = False) -> None:
        """Offer the last of some states to be drawn; costs the caller next to nothing.

        Args:
            history: of the ticks just flown.
            always: even where the frame before is not over yet.
        """
        self.offer_state(lambda: (_last_of(history.state), int(history.ticks[-1])), always)

    def show(self, simulation: Simulation) -> None:
        """Offer the present state of a simulation; its copy takes the caller some microseconds."""
        layout, buffers = simulation.packed
        copies, tick = tuple(np.array(buffer) for buffer in buffers), simulation.tick
        self.offer_state(lambda: (layout.unpack(copies), tick), always=True)  # type: ignore[arg-type]

    def _due(self) -> bool:
        """Return whether the next frame may be drawn; at every step of a clock that is paused."""
        paused = self.clock is not None and not self.clock.playing
        return paused or time.perf_counter() - self._last >= FRAME_S

    def offer_state(self, look: Look, always: bool = False) -> None:
        """Offer what ``look`` returns, as ``offer`` does."""
        if not (always or self._due()):
            return
        self._last = time.perf_counter()
        with self._there:
            self._overtaken += self._newest is not None
            self._newest = look
            self._there.notify()

    def changes(self, simulation: Simulation) -> list[dict[str, Any]]:
        """Make the changes that the page asks for, and return them as events of a run."""
        wished, self._wished = self._wished, None
        return [] if wished is None else change_wind(simulation, wished)

    def close(self) -> None:
        """Draw what is still to be drawn, and take the page off."""
        if self.clock is not None:
            self.clock.close()
        self._end_drawing()
        self._server.stop()

    def _end_drawing(self) -> None:
        with self._there:
            self._closed = True
            self._there.notify()
        if self._thread is not None:
            self._thread.join(10.0)
        self._thread = None

    # ---- the page's thread ----

    def _draw_all(self) -> None:
        while True:
            with self._there:
                self._there.wait_for(lambda: self._newest is not None or self._closed)
                look, self._newest = self._newest, None
            if look is None:
                return
            try:
                self._draw(look)
            except Exception as error:  # the flight goes on, whatever is wrong with its picture
                print(f"warning: the page shows no more: {error!r}", file=sys.stderr)
                return
            # Paced here, where the last of some states is drawn whoever offered it when.
            with self._there:
                self._there.wait_for(lambda: self._closed, FRAME_S)

    def _draw(self, look: Look) -> None:
        assert self._page is not None
        state, tick = look()
        frame = frame_of(state, tick * self._step_s)
        self._keep(state, frame)
        self._page.draw(frame, everything=self.clock is not None and not self.clock.playing)

    def _keep(self, state: State, frame: Frame) -> None:
        """Remember what the chosen vehicle measures."""
        chosen = None if self._page is None else self._page.chosen
        if chosen != self._kept or (self._values and frame.time < self._values[-1][0]):
            self._values.clear()
            self._kept = chosen
        if chosen is not None:
            self._values.append((frame.time, _measured(state, self._world, chosen), _true(state, self._world, chosen)))

    def _plotted(self, vehicle: int, quantity: str) -> tuple[Floats, Floats, Floats]:
        rows = list(self._values) if vehicle == self._kept else []
        rows = [row for row in rows if quantity in row[1]]
        if not rows:
            return (np.zeros(0),) * 3
        truth = {name: np.array([row[2][name] for row in rows]) for name in rows[0][2]}
        times = np.array([row[0] for row in rows])
        return times, np.array([row[1][quantity] for row in rows]), true_values(quantity, truth)

    def _add_wind(self, page: Page, world: World) -> None:
        wind = wind_of(world)
        if wind is None:
            return
        gui = self._server.gui
        with gui.add_folder("Change the wind"):
            speed = gui.add_slider("Speed [m/s]", 0.0, wind.fastest, 0.5, wind.speed)
            bearing = gui.add_slider("From [deg]", 0.0, 360.0, 5.0, wind.from_deg)
            button = gui.add_button("Change")

        @button.on_click
        def _(_: Any) -> None:
            self._wished = Wind(speed.value, bearing.value)


def _last_of(state: State) -> State:
    import jax

    last: State = jax.tree.map(lambda leaf: leaf[-1], state)
    return last


def _place(world: World, vehicle: int) -> tuple[int, int]:
    """Return the fleet of a vehicle, and its number in it."""
    for number, fleet in enumerate(world.fleets):
        if vehicle < fleet.size:
            return number, vehicle
        vehicle -= fleet.size
    raise IndexError(vehicle)


def _measured(state: State, world: World, vehicle: int) -> dict[str, float]:
    number, i = _place(world, vehicle)
    names, readings = world.fleets[number].sensor_names, state.fleets[number].readings
    return {
        quantity: float(np.asarray(leaf)[i])
        for name, reading in zip(names, readings, strict=True)
        for quantity, leaf, _ in walk(reading, f"{name}.")
    }


def _true(state: State, world: World, vehicle: int) -> dict[str, float]:
    number, i = _place(world, vehicle)
    fleet = state.fleets[number]
    items = [*walk(fleet.vehicle), *walk(fleet.specific_force, "specific_force.")]
    return {name: float(np.asarray(leaf)[i]) for name, leaf, _ in items if np.ndim(leaf) == 1}
