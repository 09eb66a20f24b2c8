"""A page of a running simulation; it never makes the simulation wait."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.tree import walk
from qrsim.errors import UsageError
from qrsim.scenarios.live_requests import Request, wind
from qrsim.simulation.history import History
from qrsim.simulation.simulation import Simulation
from qrsim.tasks.places import Places
from qrsim.view.clock import FRAME_S, SPEEDS, Clock
from qrsim.view.failing import FailingControls, targets_of_all
from qrsim.view.frame import Frame, cast_of, frame_of
from qrsim.view.live_paint import LivePaints
from qrsim.view.page import PLOT_FRAMES, WIND, Page
from qrsim.view.recording import Recording
from qrsim.view.replay import Replay
from qrsim.view.script import run_script
from qrsim.view.server import LOOPBACK, address, start_server
from qrsim.view.sky import Satellite, of_satellites, sky_of_state
from qrsim.view.steering import steered, wind_of
from qrsim.view.truth import true_values
from qrsim.world.state import State, World

# What a plot keeps: a minute of simulated time, in so many values.
PLOT_S, MOST_VALUES = 60.0, 900
# What waits to be done at the next tick; of more, the oldest is dropped.
MOST_ASKED = 64


@dataclass(frozen=True)
class _Offered:
    """States of consecutive ticks that may be drawn.

    Attributes:
        look: returns one of them and its tick; called in the page's thread.
        count: how many there are.
        arrived: wall time [s].
    """

    look: Callable[[int], tuple[State, int]]
    count: int
    arrived: float


class LiveView:
    """Shows a simulation.

    The simulation's thread calls ``begin`` once, then ``offer`` as often as it likes; one of the page's own draws of
    what was offered last, 30 times a second. Many states that are offered together are drawn one after the other, in
    the time that they took to come.

    Args:
        port: to listen on; where it is taken, the next free one.
        clock: by which the simulation goes; None where it goes by another.
        host: address of this machine to listen on.

    Attributes:
        address: to open in a browser.
    """

    def __init__(self, port: int, clock: Clock | None = None, host: str = LOOPBACK):
        self.clock = clock
        self._server = start_server(port, host=host)
        self.address = address(self._server)
        self._newest: _Offered | None = None
        self._there = threading.Condition()
        self._closed = False
        self._page: Page | None = None
        self._thread: threading.Thread | None = None
        self._overtaken = 0
        self._asked: deque[Request] = deque(maxlen=MOST_ASKED)
        # Of each vehicle that a browser has chosen.
        self._values: dict[int, deque[tuple[float, dict[str, float], dict[str, float]]]] = {}
        self._skies: dict[int, list[Satellite]] = {}
        self._waiting: Any = None
        self._ended = threading.Event()

    @property
    def browsers(self) -> int:
        """Number of browsers that show the page."""
        return len(self._server.get_clients())

    def wait_for(self, what: str) -> None:
        """Show on a page without a simulation what the program waits for, such as "a browser"."""
        if self._page is not None:
            return
        if self._waiting is None:
            self._waiting = self._server.gui.add_markdown("")
            self._server.gui.set_panel_label("qrsim")
            run_script(self._server, "title", 'document.title = "qrsim"')
        self._waiting.content = f"**qrsim**  \nThis page waits for {what}."

    def note(self, text: str) -> None:
        """Show one line of text about the whole run on the page."""
        if self._page is not None:
            self._page.say(text)

    def begin(self, simulation: Simulation, heading: str, places: Places | None = None) -> None:
        """Show a new simulation in place of the present one, with its heading and the goals of its task."""
        self._clear()
        world = simulation.world
        site = simulation.site
        origin = (math.degrees(site.latitude_rad), math.degrees(site.longitude_rad), site.height)
        cast = replace(cast_of(world, simulation.truth.position_ned, places), site=origin)
        page = Page(self._server, cast, world, heading, self.clock)
        page.dropped = lambda: self._overtaken
        page.plotted, page.sky = self._plotted, lambda vehicle: self._skies.get(vehicle, [])
        targets = targets_of_all(world)
        if any(targets):
            page.failing = lambda gui: FailingControls(gui, targets, page.scene.cast.names, self.ask, self.note)
        page.add_plots(list(_measured(simulation.state, world, 0)))
        self._paints = LivePaints(cast.size)
        page.add_colours(self._paints.names, self._paints.of)
        self._add_wind(page, world)
        self._page, self._world, self._step_s = page, world, world.time_step
        self._values, self._skies = {}, {}
        self._thread = threading.Thread(target=self._draw_all, name="view", daemon=True)
        self._closed = False
        self.offer(simulation.history)
        self._thread.start()

    def replay(self, recording: Recording) -> None:
        """Replace the live simulation by a recording of it, at its end, keeping the users' choices on the page."""
        before = self._page
        self._clear()
        live = self.clock.speed if self.clock is not None else 1.0
        clock = Clock(min(live, SPEEDS[-2]), playing=False, speeds=SPEEDS[:-1])
        page = Page(self._server, recording.cast, recording.world, recording.heading, clock)
        page.note = f"The flight has ended, at {recording.end:g} s. This is its replay."
        player = Replay(recording, page, clock, recording.end)
        if before is not None:
            page.adopt(before)
        self._page, self.clock = page, clock
        self._thread = threading.Thread(target=player.run, args=(self._ended,), name="view", daemon=True)
        self._thread.start()

    def _clear(self) -> None:
        """Stop the drawing thread and empty the page, before the next simulation is shown."""
        self._end_drawing()
        if self._page is not None:
            self._page.close()
        self._server.gui.reset()
        self._server.scene.reset()
        self._waiting = None

    def wait(self, most: int) -> int:
        """Wait while paused or too fast; return the number of ticks to simulate next, at most ``most``."""
        return most if self.clock is None else self.clock.wait(self._step_s, most)

    def offer(self, history: History) -> None:
        """Queue the simulated states of a history for drawing; return at once."""
        self._offer(lambda row: (_row(history.state, row), int(history.ticks[row])), len(history.ticks))

    def show(self, simulation: Simulation) -> None:
        """Queue the present state of a simulation for drawing; return at once."""
        layout, buffers = simulation.packed
        copies, tick = tuple(np.array(buffer) for buffer in buffers), simulation.tick
        self._offer(lambda _: (layout.unpack(copies), tick), 1)  # type: ignore[arg-type]

    def _offer(self, look: Callable[[int], tuple[State, int]], count: int) -> None:
        """Replace the states that wait to be drawn by ``count`` new ones; ``look`` returns (state, tick) of one."""
        with self._there:
            self._newest = _Offered(look, count, time.perf_counter())
            self._there.notify()

    def change(self, simulation: Simulation) -> None:
        """Apply to the simulation the changes that users have requested on the page."""
        while self._asked:
            try:
                line = steered(simulation, self._asked.popleft())
            except UsageError as error:
                self.note(f"Not done: {error}")
                continue
            self.note(f"{line}, at {simulation.time:.2f} s")
            self._world = simulation.world

    def ask(self, request: Request) -> None:
        """Queue a request, such as a fault or other wind, for the next tick; return at once."""
        self._asked.append(request)
        if self.clock is not None and not self.clock.playing:
            self.note("Asked for; it acts from the next tick on.")

    def close(self) -> None:
        """Draw the last queued states, then close the page and its server."""
        self._ended.set()
        if self.clock is not None:
            self.clock.close()
        self._end_drawing()
        self._server.stop()

    def _end_drawing(self) -> None:
        """Wait until the drawing thread has drawn the queued states and ended."""
        with self._there:
            self._closed = True
            self._there.notify()
        if self._thread is not None:
            self._thread.join(10.0)
        self._thread = None

    # ---- the page's thread ----

    def _draw_all(self) -> None:
        """Draw the newest states until the view closes; runs in the drawing thread."""
        due, span, before = time.perf_counter(), 0.0, None
        offered: _Offered | None = None
        row = -1
        while True:
            with self._there:
                # What was drawn to its end waits for something newer.
                self._there.wait_for(lambda: self._newest or self._closed or (offered and row < offered.count - 1))  # noqa: B023
                if self._newest is not None:
                    offered, self._newest, row = self._newest, None, -1
                    span, before = offered.arrived - (before or offered.arrived), offered.arrived
                    # While nothing came, nothing was due.
                    due = max(due, offered.arrived)
            if offered is None or (self._closed and row == offered.count - 1):
                return
            try:
                row = self._draw(offered, row, 0.0 if self._closed else span)
            except Exception as error:  # the flight goes on, whatever is wrong with its picture
                print(f"warning: the page shows no more: {error!r}", file=sys.stderr)
                return
            due = self._pace(due)

    def _pace(self, due: float) -> float:
        """Wait until one frame after the time ``due`` [s], and return that time; late frames are dropped."""
        due, now = due + FRAME_S, time.perf_counter()
        if now > due:
            self._overtaken += int((now - due) / FRAME_S)
            return now
        with self._there:
            self._there.wait_for(lambda: self._closed, due - now)
        return due

    def _draw(self, offered: _Offered, row: int, span: float) -> int:
        """Draw the state of ``offered`` that is due within ``span`` [s], if later than ``row``; return its number."""
        assert self._page is not None
        share = (time.perf_counter() - offered.arrived + FRAME_S) / max(span, FRAME_S)
        now = min(offered.count - 1, max(0, int(share * offered.count) - 1))
        if now <= row:
            return row
        state, tick = offered.look(now)
        frame = frame_of(state, tick * self._step_s, self._world)
        self._keep(state, frame)
        paint = self._paints.note(frame, self._page.scene.stage.paint)
        if paint is not None:
            self._page.scene.colour(paint)
        self._page.draw(frame, everything=self.clock is not None and not self.clock.playing)
        return now

    def _keep(self, state: State, frame: Frame) -> None:
        """Store the chosen vehicles' readings and true values of a state for their plots."""
        chosen = frozenset() if self._page is None else self._page.chosen
        values = {vehicle: self._values.get(vehicle, deque()) for vehicle in sorted(chosen)}
        for vehicle, own in values.items():
            if own and frame.time < own[-1][0]:
                own.clear()
            # The newest is always kept, and closer to it than this nothing else.
            if len(own) > 1 and own[-1][0] - own[-2][0] < PLOT_S / MOST_VALUES:
                own.pop()
            while own and own[0][0] < frame.time - PLOT_S:
                own.popleft()
            own.append((frame.time, _measured(state, self._world, vehicle), _true(state, self._world, vehicle)))
        self._values = values
        if chosen and self._page is not None and self._page.drawn % PLOT_FRAMES == 0:
            self._skies = {vehicle: sky_of_state(state, *_place(self._world, vehicle)) for vehicle in chosen}

    def _plotted(self, vehicle: int, quantity: str) -> tuple[Floats, Floats, Floats]:
        """Return times [s], readings and true values of a vehicle's quantity, as kept since it was chosen."""
        rows = [row for row in list(self._values.get(vehicle, ())) if quantity in row[1]]
        if not rows:
            return (np.zeros(0),) * 3
        truth = {name: np.array([row[2][name] for row in rows]) for name in rows[0][2]}
        times = np.array([row[0] for row in rows])
        return times, np.array([row[1][quantity] for row in rows]), true_values(quantity, truth)

    def _add_wind(self, page: Page, world: World) -> None:
        """Add the wind controls to the page, if the world's wind can be changed."""
        blows = wind_of(world)
        if blows is None:
            return
        gui = self._server.gui
        with gui.add_folder("Change the wind", order=WIND):
            speed = gui.add_slider("Speed [m/s]", 0.0, blows.fastest, 0.5, blows.speed)
            bearing = gui.add_slider("From [deg]", 0.0, 360.0, 5.0, blows.from_deg)
            button = gui.add_button("Change")

        @button.on_click
        def _(_: object) -> None:
            """Request the wind that the two sliders show."""
            self.ask(wind(speed.value, bearing.value))


def _row(state: State, row: int) -> State:
    """Return state number ``row`` of a tree of states stacked along the first axis."""
    import jax

    found: State = jax.tree.map(lambda leaf: leaf[row], state)
    return found


def _place(world: World, vehicle: int) -> tuple[int, int]:
    """Return (fleet number, number in that fleet) of a vehicle by its number among all."""
    for number, fleet in enumerate(world.fleets):
        if vehicle < fleet.size:
            return number, vehicle
        vehicle -= fleet.size
    raise IndexError(vehicle)


def _measured(state: State, world: World, vehicle: int) -> dict[str, float]:
    """Return "sensor.quantity" -> latest reading of a vehicle, without readings for single satellites."""
    number, i = _place(world, vehicle)
    names, readings = world.fleets[number].sensor_names, state.fleets[number].readings
    return {
        quantity: float(np.asarray(leaf)[i])
        for name, reading in zip(names, readings, strict=True)
        for quantity, leaf, _ in walk(reading, f"{name}.")
        if not of_satellites(quantity)
    }


def _true(state: State, world: World, vehicle: int) -> dict[str, float]:
    """Return the true values of one vehicle by name: its state, pose and specific force."""
    number, i = _place(world, vehicle)
    fleet = state.fleets[number]
    pose = world.fleets[number].vehicle.pose(fleet.vehicle)
    items = [*walk(fleet.vehicle), *walk(pose), *walk(fleet.specific_force, "specific_force.")]
    return {name: float(np.asarray(leaf)[i]) for name, leaf, _ in items if np.ndim(leaf) == 1}
