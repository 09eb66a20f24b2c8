"""The part of a simulation that changes its parameters in flight: faults and weather."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.core.arrays import is_number
from qrsim.engine.layout import Buffers, Packer
from qrsim.errors import LONGEST_NAME, RunError, UsageError, os_error_as
from qrsim.files.atomic import write_atomically
from qrsim.files.yaml_text import dump_line
from qrsim.models.sensors.faults import LAST_TICK
from qrsim.simulation.alone import Alone, alone
from qrsim.simulation.changing import GUSTS, JAM, WIND, Weather, weather_of, with_weather
from qrsim.simulation.injections import (
    LINK,
    MOST_AT_ONCE,
    OK,
    WORLD,
    Injected,
    Injection,
    injected,
    named_vehicles,
    plain_target,
    targets_of,
    without_faults,
)
from qrsim.simulation.one_world import OneWorld
from qrsim.simulation.requests import after_request, entry_of, first_tick, last_tick, of_sensor
from qrsim.world.state import World


class Injecting(Alone):
    """The part of a ``Simulation`` whose sensors, rotors and batteries can be made to fail.

    What may fail has a slot in the scenario (``injectable``), which is compiled; a fault is numbers in it. It acts from
    the next tick on, and ends at a reset.
    """

    world: World
    tick: int
    precision_context: Callable[[], AbstractContextManager[object]]
    _ticks: OneWorld
    _state: Buffers | None

    def __init__(self) -> None:
        super().__init__()
        self._injections: list[Injection] = []
        self._requests: list[Injection] = []
        # The scenario's own weather, kept from the first request that changes it.
        self._weather: Weather | None = None
        self._count = 0
        self._asked: tuple[int, int] = (-1, 0)

    @alone
    def change_world(self, world: World) -> None:
        """Replace the world's parameters from the next tick on, without compiling again; injected faults stay.

        Raises:
            UsageError: something else than numbers differs.
        """
        if any(new is not now for new, now in zip(weather_of(world), weather_of(self.world), strict=True)):
            self._weather = None
        if any(targets_of(fleet) for fleet in world.fleets):
            # What is in the slots of the world that is given may be older than what was injected since.
            world = without_faults(world)
            for one in self._injections:
                world, _ = after_request(world, one)
        self._take(world)

    @alone
    def inject(
        self,
        /,
        target: str,
        kind: str,
        vehicles: Iterable[str] | str | None = None,
        at: float | None = None,
        duration: float | None = None,
        asked_by: str = "python",
        **numbers: Any,
    ) -> int:
        """Inject a fault of a sensor or part (``target``) from the next tick, or a time ``at`` [s], on; return the
        fault's number.

        A vehicle has one injected fault of a target at a time: a new one takes its place.

        Args:
            target: name of a sensor, ``rotor N``, ``battery``, ``radio`` or ``body``, which is ``injectable`` in the
                scenario; or ``link``, that of a vehicle to MAVLink and ROS 2.
            kind: of a sensor ``off``, ``stuck``, ``wrong``, ``drift``, ``noisy``, ``garbage``, ``slow``, ``delayed`` or
                ``intermittent``; of a rotor ``off``, ``weak`` or ``stuck``; of a radio ``off`` or ``weak``; of a
                battery ``drop`` or ``weak``; of a link ``off``; of a body ``push``; ``ok`` for none.
            vehicles: name or names; None: all that can have it.
            at: when [s], rounded up to a tick; None: from the next tick on.
            duration: how long [s]; None: for good.
            asked_by: who asks, for records.
            numbers: how large it is: ``field`` and ``bias``, ``scale``, ``rate``, ``limit``, ``std``, ``range``,
                ``every``, ``by``, ``share``, ``on``, ``off`` of a sensor, ``health`` or ``speed`` of a rotor,
                ``share`` of a radio, ``charge`` that a battery drops to, or its ``health``; ``acceleration_ned`` or
                ``acceleration_body`` of a push, 3 numbers [m/s^2].

        Raises:
            UsageError: it cannot be injected; nothing has changed.
        """
        for name, text in (("target", target), ("kind", kind), ("asked_by", asked_by)):
            if not (isinstance(text, str) and text.isprintable() and len(text) <= LONGEST_NAME):
                raise UsageError(f"{name}: {text!r:.60}; allowed: one line of at most {LONGEST_NAME} characters")
        target, kind, asked_by = plain_target(str(target)), str(kind), str(asked_by)
        if target == WORLD:
            if (vehicles, at, duration) != (None, None, None):
                raise UsageError("vehicles, at, duration: the world changes for all, from the next tick on")
            self.change_weather(kind, numbers, asked_by)
            return 0
        if kind == OK and (at is not None or duration is not None):
            raise UsageError("at, duration: kind 'ok' ends a fault at once; use 'duration' of the fault itself")
        if self._asked == (self.tick, MOST_AT_ONCE):
            raise UsageError(f"inject: at most {MOST_AT_ONCE} faults in one tick")
        dt = self.world.time_step
        start = first_tick(at, self.tick, dt, 1 if of_sensor(self.world, target) else 0)
        ticks = (start, last_tick(duration, start, dt))
        numbers = {name: plain(value) for name, value in numbers.items()}
        chosen = tuple(named_vehicles(self.world, vehicles) or ())
        self._make([Injection(self._count + 1, target, kind, chosen, *ticks, numbers, asked_by, self.tick)])
        self._asked = (self.tick, self._asked[1] + 1 if self._asked[0] == self.tick else 1)
        return self._count

    def push(
        self,
        acceleration_ned: Sequence[float],
        duration: float,
        vehicles: Iterable[str] | str | None = None,
        asked_by: str = "python",
    ) -> int:
        """Push vehicles with an acceleration NED [m/s^2] for ``duration`` [s] from the next tick on; return the push's
        number, by which ``clear`` ends it early.

        Args:
            acceleration_ned: north, east, down [m/s^2]: the force per mass. Rovers are pushed along the ground only.
            duration: how long [s], rounded up to a tick.
            vehicles: name or names; None: all whose ``body`` is ``injectable`` in the scenario.
            asked_by: who asks, for records.

        Raises:
            UsageError: a vehicle cannot be pushed, or a number is out of range; nothing has changed.
        """
        return self.inject(
            "body", "push", vehicles, duration=duration, asked_by=asked_by, acceleration_ned=acceleration_ned
        )

    @alone
    def clear(
        self,
        what: int | str | None = None,
        vehicles: Iterable[str] | str | None = None,
        asked_by: str = "python",
    ) -> None:
        """End injected faults: one by its number, those of a target by its name, or all (None); unknown ones are
        ignored.

        Args:
            what: number of a fault, or a target; None: all.
            vehicles: name or names; None: all.
            asked_by: who asks, for records.

        Raises:
            UsageError: there is no such target or vehicle.
        """
        names = named_vehicles(self.world, vehicles)
        what = plain_target(what) if isinstance(what, str) else what
        chosen = [one for one in self._injections if what is None or what in (one.id, one.target)]
        if isinstance(what, str) and not chosen:
            injected(self.world, what, OK, names, (0, 0), {})
        ends = []
        for one in chosen:
            mine = tuple(name for name in one.vehicles if names is None or name in names)
            if mine:
                ends.append(Injection(0, one.target, OK, mine, self.tick, self.tick, {}, asked_by, self.tick))
        self._make(ends)

    @property
    def injected(self) -> Injected:
        """Injected faults that act now or will act, as a table."""
        with self._lock:
            return Injected([one for one in self._injections if one.end_tick > self.tick], self.world.time_step)

    @property
    def requests(self) -> list[Injection]:
        """All injection requests since the reset, in order: faults, ends of faults, changes of the weather."""
        return list(self._requests)

    @property
    def unlinked(self) -> frozenset[str]:
        """Names of the vehicles with an injected loss of their link to MAVLink or ROS 2."""
        if not self._injections:
            return frozenset()
        now = self.tick
        off = [one for one in self._injections if one.target == LINK and one.start_tick <= now < one.end_tick]
        return frozenset(name for one in off for name in one.vehicles)

    def write_requests(self, path: str | Path) -> None:
        """Write all injection requests since the reset to a YAML file, which ``qrsim run --inject`` reads.

        Raises:
            RunError: it cannot be written.
        """
        lines = [f"- {dump_line(entry_of(one, self.world.time_step))}\n" for one in self.requests]
        with os_error_as(RunError, f"cannot write the requests {path}"):
            write_atomically(Path(path), "".join(lines or ["[]\n"]).encode())

    @alone
    def repeat(self, requests: Sequence[Injection]) -> None:
        """Make injection requests that were recorded in another flight again, all at once.

        Args:
            requests: with the ticks at which their faults begin and end.

        Raises:
            UsageError: one is not possible in this world; nothing has changed.
        """
        count, renewed = self._count, []
        for request in requests:
            # Only faults have an id, by which they can be ended.
            fault = request.kind != OK and request.target != WORLD
            count += fault
            renewed.append(dataclasses.replace(request, tick=self.tick, id=count if fault else 0))
        self._make(renewed)

    def set_wind(self, speed: float, from_deg: float, over: float = 0.0, asked_by: str = "python") -> None:
        """Change the mean wind from the next tick on: speed [m/s] at 20 ft, bearing [deg], within ``over`` [s].

        Args:
            speed: 20 ft above the ground [m/s].
            from_deg: bearing it comes from [degrees].
            over: how long the change takes [s]; above 0 where ``world.injectable`` of the scenario has wind.
            asked_by: who asks, for records.

        Raises:
            UsageError: the wind has no one speed and direction, an episode draws it, or a number out of range.
        """
        self.change_weather(WIND, {"speed_20ft": speed, "wind_from_deg": from_deg, "over": over}, asked_by)

    def set_gusts(self, times: float, over: float = 0.0, asked_by: str = "python") -> None:
        """Multiply the random gusts by ``times`` from the next tick on; the scenario's ``world.injectable`` has to name
        ``gusts``.

        Args:
            times: what the gusts of the scenario are multiplied by.
            over: how long the change takes [s].
            asked_by: who asks, for records.

        Raises:
            UsageError: it cannot be changed, or a number is out of range.
        """
        self.change_weather(GUSTS, {"times": times, "over": over}, asked_by)

    def set_jammer(self, jammer: int, power_w: float, over: float = 0.0, asked_by: str = "python") -> None:
        """Set the power [W] of jammer number ``jammer`` from the next tick on; the scenario's ``world.injectable`` has
        to name ``jam``.

        Args:
            jammer: which one of the jammers in ``world.interference``, from 0.
            power_w: power that it radiates [W].
            over: how long the change takes [s].
            asked_by: who asks, for records.

        Raises:
            UsageError: it cannot be changed, or a number is out of range.
        """
        self.change_weather(JAM, {"jammer": jammer, "power_w": power_w, "over": over}, asked_by)

    @alone
    def change_weather(self, kind: str, numbers: Mapping[str, object], asked_by: str = "python") -> None:
        """Change wind, gusts or a jammer (``kind``) from the next tick on, with numbers as in a file of injections.

        Args:
            kind: ``wind``, ``gusts`` or ``jam``.
            numbers: by the names that files of injections have.
            asked_by: who asks, for records.

        Raises:
            UsageError: it cannot be changed, or a number is missing or out of range.
        """
        given = {name: plain(value) for name, value in numbers.items() if value is not None}
        if given.get("over") == 0.0:
            del given["over"]
        jammer = given.get("jammer")
        # Links have no whole numbers.
        if isinstance(jammer, float) and jammer.is_integer():
            given["jammer"] = int(jammer)
        self._make([Injection(0, WORLD, kind, (), self.tick, LAST_TICK, given, asked_by, self.tick)])

    # ---- for resets and saved states ----

    def _make(self, requests: Sequence[Injection]) -> None:
        """Apply injection requests to the world as one change, and record them."""
        world, made = self.world, []
        for request in requests:
            world, request = after_request(world, request)
            made.append(request)
        if made and self._state is None:
            raise UsageError("the simulation has not started; call reset() first, which begins without injected faults")
        before = weather_of(self.world)
        self._take(world)
        for request in made:
            if request.target == WORLD:
                self._weather = self._weather or before
            if request.target == WORLD or self._note(request):
                self._requests.append(request)

    def _take(self, world: World) -> None:
        """Continue in a world with other parameters; raises UsageError if it differs from the present one in more than
        numbers."""
        if world is self.world:
            return
        if Packer(world) != self._ticks.layout:
            raise UsageError("world: it differs in more than numbers from the one that flies; make another Simulation")
        with self.precision_context():
            self.world, self._ticks = world, OneWorld(world)

    def _note(self, injection: Injection) -> bool:
        """Record an injection in place of earlier ones with its target and vehicles; return False if it changes
        nothing."""
        kept, ended, concerned = [], False, set(injection.vehicles)
        for one in self._injections:
            left = one.vehicles
            if one.target == injection.target:
                left = tuple(name for name in one.vehicles if name not in concerned)
                ended |= left != one.vehicles and one.end_tick > self.tick
            kept += [dataclasses.replace(one, vehicles=left)] if left else []
        self._injections = kept + ([injection] if injection.kind != OK else [])
        self._count = max(self._count, injection.id)
        return ended or injection.kind != OK

    def _clear_all(self) -> None:
        """Remove all injected faults, and undo all changes of the weather."""
        world = self._first_world
        self._requests, self._injections, self._weather, self._asked = [], [], None, (-1, 0)
        self._take(world)

    def _injections_text(self) -> str:
        """Return the injected faults and weather changes as JSON text, for a saved state."""
        weather = [one for one in self._requests if one.target == WORLD]
        return json.dumps([dataclasses.asdict(one) for one in (*weather, *self._injections)])

    @property
    def _first_world(self) -> World:
        """World without injected faults and changes of the weather."""
        world = without_faults(self.world) if self._injections else self.world
        return world if self._weather is None else with_weather(world, self._weather)

    def _inject_again(self, text: str) -> None:
        """Replace the injected faults and weather changes by those in the JSON text of a saved state.

        Raises:
            UsageError: they are none of this world.
        """
        first = self._first_world
        world, kept = without_faults(first), []
        try:
            for entry in json.loads(text):
                one = Injection(**entry | {"vehicles": tuple(entry["vehicles"])})
                if not all(type(number) is int and 0 <= number <= LAST_TICK for number in one.counts):
                    raise ValueError
                world, _ = after_request(world, one)
                kept.append(one)
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
            raise UsageError("saved state: its injected faults are damaged") from None
        if kept or self._requests or self._injections:
            self._take(world)
        self._injections = [one for one in kept if one.target != WORLD]
        self._requests = kept
        self._weather = weather_of(first) if len(kept) > len(self._injections) else None
        self._count = max([self._count, *(one.id for one in kept)])


def plain(value: Any) -> Any:
    """Convert NumPy numbers, texts, lists and mappings to plain Python values, which JSON can store."""
    if isinstance(value, Mapping):
        return {str(name): plain(number) for name, number in value.items()}
    if isinstance(value, str):
        return str(value)
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(number) for number in value]
    if not is_number(value):
        return value
    return int(value) if isinstance(value, Integral) else float(value)
