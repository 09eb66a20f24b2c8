"""The part of a simulation whose parameters change while it flies: wind, and what fails."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from qrsim.core.tree import field_info, replace
from qrsim.engine.layout import Packer
from qrsim.errors import UsageError
from qrsim.models.atmosphere.wind import LogShear
from qrsim.models.atmosphere.wind_series import VeeringShear
from qrsim.models.sensors.faults import LAST_TICK
from qrsim.simulation.alone import Alone, alone
from qrsim.simulation.injections import (
    LINK,
    MOST_AT_ONCE,
    Injected,
    Injection,
    first_tick,
    injected,
    is_number,
    last_tick,
    named_vehicles,
    plain_target,
    without_faults,
)
from qrsim.simulation.one_world import OneWorld
from qrsim.world.state import World


class Injecting(Alone):
    """The part of a ``Simulation`` whose sensors, rotors and batteries can be made to fail.

    What may fail has a slot in the scenario (``injectable``), which is compiled; a fault is numbers in it. It acts from
    the next tick on, and ends at a reset.
    """

    world: World
    tick: int
    precision_context: Callable[[], Any]
    _ticks: OneWorld

    def __init__(self) -> None:
        super().__init__()
        self._injections: list[Injection] = []
        self._count = 0
        self._asked: tuple[int, int] = (-1, 0)

    @alone
    def change_world(self, world: World) -> None:
        """Change parameters from the next tick on; nothing is recompiled.

        Raises:
            UsageError: something else than numbers differs.
        """
        if Packer(world) != self._ticks.layout:
            raise UsageError("world: it differs in more than numbers from the one that flies; make another Simulation")
        with self.precision_context():
            self.world, self._ticks = world, OneWorld(world)

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
        """Let something fail, and return the number of the fault.

        A vehicle has one injected fault of a target at a time: a new one takes its place.

        Args:
            target: name of a sensor, ``rotor N``, ``battery`` or ``radio``, which is ``injectable`` in the scenario; or
                ``link``, that of a vehicle to MAVLink and ROS 2.
            kind: of a sensor ``off``, ``stuck``, ``wrong``, ``drift``, ``noisy``, ``garbage``, ``slow``, ``delayed`` or
                ``intermittent``; of a rotor or radio ``off`` or ``weak``; of a battery ``drop``; of a link ``off``;
                ``ok`` for none.
            vehicles: name or names; None: all that can have it.
            at: when [s], rounded up to a tick; None: from the next tick on.
            duration: how long [s]; None: for good.
            asked_by: who asks, for records.
            numbers: how large it is: ``field`` and ``bias``, ``scale``, ``rate``, ``limit``, ``std``, ``range``,
                ``every``, ``by``, ``share``, ``on``, ``off`` of a sensor, ``health`` of a rotor, ``share`` of a
                radio, ``charge`` that a battery drops to.

        Raises:
            UsageError: it cannot be injected; nothing has changed.
        """
        target = plain_target(target)
        if kind == "ok" and (at is not None or duration is not None):
            raise UsageError("at, duration: kind 'ok' ends a fault at once; use 'duration' of the fault itself")
        if self._asked == (self.tick, MOST_AT_ONCE):
            raise UsageError(f"inject: at most {MOST_AT_ONCE} faults in one tick")
        dt = self.world.time_step
        # What a sensor says at the next tick is the first that a fault of it can change.
        start = first_tick(at, self.tick, dt, 1 if _of_sensor(self.world, target) else 0)
        ticks = (start, last_tick(duration, start, dt))
        # As Python's own, which saved states can have.
        numbers = {name: value.item() if isinstance(value, np.generic) else value for name, value in numbers.items()}
        world, concerned = injected(self.world, target, kind, named_vehicles(self.world, vehicles), ticks, numbers)
        self._take(world)
        self._asked = (self.tick, self._asked[1] + 1 if self._asked[0] == self.tick else 1)
        self._count += 1
        self._note(Injection(self._count, target, kind, concerned, *ticks, numbers, asked_by))
        return self._count

    @alone
    def clear(self, what: int | str | None = None, vehicles: Iterable[str] | str | None = None) -> None:
        """End injected faults: one by its number, those of a target, or all; what is not there does nothing.

        Args:
            what: number of a fault, or a target; None: all.
            vehicles: name or names; None: all.

        Raises:
            UsageError: there is no such target or vehicle.
        """
        names = named_vehicles(self.world, vehicles)
        what = plain_target(what) if isinstance(what, str) else what
        chosen = [one for one in self._injections if what is None or what in (one.id, one.target)]
        if isinstance(what, str) and not chosen:
            injected(self.world, what, "ok", names, (0, 0), {})
        world = self.world
        for one in chosen:
            mine = [name for name in one.vehicles if names is None or name in names]
            if mine:
                world, _ = injected(world, one.target, "ok", mine, (0, 0), {})
                self._note(Injection(0, one.target, "ok", tuple(mine), 0, 0))
        self._take(world)

    @property
    def injected(self) -> Injected:
        """The injected faults that act or will act, as a table."""
        with self._lock:
            return Injected([one for one in self._injections if one.end_tick > self.tick], self.world.time_step)

    @property
    def unlinked(self) -> frozenset[str]:
        """Names of the vehicles whose link to MAVLink and ROS 2 is off now."""
        if not self._injections:
            return frozenset()
        now = self.tick
        off = [one for one in self._injections if one.target == LINK and one.start_tick <= now < one.end_tick]
        return frozenset(name for one in off for name in one.vehicles)

    @alone
    def set_wind(self, speed: float, from_deg: float) -> None:
        """Change the mean wind from the next tick on.

        Args:
            speed: 20 ft above the ground [m/s].
            from_deg: bearing it comes from [degrees].

        Raises:
            UsageError: the wind has no one speed and direction, an episode draws it, or a number out of range.
        """
        most = wind_limit(self.world)
        for name, value, allowed in (("speed", speed, f"0 to {most:g} m/s"), ("from_deg", from_deg, "a finite number")):
            if not is_number(value) or not math.isfinite(value):
                raise UsageError(f"{name}: {value!r}; allowed: {allowed}")
        if not 0.0 <= speed <= most:
            raise UsageError(f"speed: {speed:g} m/s; allowed: 0 to {most:g} m/s")
        self._take(with_wind(self.world, speed, from_deg))

    # ---- for resets and saved states ----

    def _take(self, world: World) -> None:
        if world is not self.world:
            self.change_world(world)

    def _note(self, injection: Injection) -> None:
        """Keep an injection in place of those of its target and vehicles; ``ok`` is none."""
        kept = []
        for one in self._injections:
            left = tuple(name for name in one.vehicles if name not in injection.vehicles)
            left = left if one.target == injection.target else one.vehicles
            kept += [dataclasses.replace(one, vehicles=left)] if left else []
        self._injections = kept + ([injection] if injection.kind != "ok" else [])

    def _clear_all(self) -> None:
        """Have no injected fault any more."""
        if self._injections:
            self._injections = []
            self._take(without_faults(self.world))

    def _injections_text(self) -> str:
        return json.dumps([dataclasses.asdict(one) for one in self._injections])

    def _inject_again(self, text: str) -> None:
        """Have the injected faults of a saved state, and no others.

        Raises:
            UsageError: they are none of this world.
        """
        world, kept = without_faults(self.world), []
        try:
            for entry in json.loads(text):
                one = Injection(**entry | {"vehicles": tuple(entry["vehicles"])})
                if not all(type(number) is int and 0 <= number <= LAST_TICK for number in one.counts):
                    raise ValueError
                ticks = (one.start_tick, one.end_tick)
                world, _ = injected(
                    world, one.target, one.kind, named_vehicles(world, one.vehicles), ticks, one.numbers
                )
                kept.append(one)
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
            raise UsageError("saved state: its injected faults are damaged") from None
        if kept or self._injections:
            self._take(world)
        self._injections, self._count = kept, max([self._count, *(one.id for one in kept)])


def _of_sensor(world: World, target: str) -> bool:
    return any(target in fleet.sensor_names for fleet in world.fleets)


def wind_limit(world: World) -> float:
    """Return the largest speed [m/s], 20 ft above the ground, that the mean wind of a world can be changed to.

    Raises:
        UsageError: it cannot be changed.
    """
    # What every episode draws anew would win over any change.
    if any(path[:1] == ("wind",) for item in world.ranges for path in item.paths):
        raise UsageError("wind: every episode draws it (ranges), so it cannot be changed in flight")
    wind = world.wind
    if not isinstance(wind, LogShear | VeeringShear):
        raise UsageError("wind: only that of type log_shear, or a series over time, can be changed in flight")
    limit = next(field_info(field).maximum for field in dataclasses.fields(wind) if field.name == "speed_20ft")
    return math.inf if limit is None else limit


def with_wind(world: World, speed: float, from_deg: float) -> World:
    """Return a world with another mean wind: speed [m/s] at 20 ft, and bearing [degrees] it comes from."""
    wind: Any = world.wind
    dtype = np.asarray(wind.speed_20ft).dtype
    bearing = np.asarray(math.radians(from_deg), dtype)
    return replace(world, wind=replace(wind, speed_20ft=np.asarray(speed, dtype), wind_from_rad=bearing))
