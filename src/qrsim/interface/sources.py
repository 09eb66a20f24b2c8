"""The readings of a fleet's sensors, with their times and the reasons for missing ones."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, cast

import jax
import numpy as np
from jax import Array

from qrsim.core.tree import Record
from qrsim.interface.seen import Offsets, Seen
from qrsim.models.gnss.receivers import GnssReading
from qrsim.models.scene.area import reason_text
from qrsim.models.sensors.camera import Picture
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.sensors.faults import Fault
from qrsim.models.sensors.fitting import Transit
from qrsim.models.site import Site
from qrsim.world.episode import picture
from qrsim.world.state import FleetState, State, World


class FleetSource:
    """The last readings of one fleet in a state.

    Args:
        world: its parameters.
        number: of the fleet.
        state: of the world; between two ticks of a rollout only what readings need.
        tick: of the state.
        site: origin of the local frame.
        rows: vehicles of the fleet that are shown.
    """

    def __init__(self, world: World, number: int, state: State, tick: int, site: Site, rows: slice):
        self.world, self.number, self.state, self.tick, self.site, self.rows = world, number, state, tick, site, rows
        self.fleet, self.time_step = world.fleets[number], world.time_step

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vehicles in ``rows``."""
        return self.fleet.vehicle_names[self.rows]

    @cached_property
    def now(self) -> FleetState:
        """Present state of the fleet."""
        return self.state.fleets[self.number]

    def offsets(self, sensor: str) -> Mapping[str, Offsets]:
        """Return field -> indices in the packed state's float buffer for a sensor's reading; {} if the state is not
        packed."""
        state = self.state
        if not isinstance(state, Seen):
            return {}
        return state.offsets.of_readings(self.number, self.fleet.sensor_names.index(sensor))

    @property
    def pictured(self) -> bool:
        """True if camera pictures can be computed here: the whole state is known, unlike inside a rollout."""
        return isinstance(self.state, State | Seen)

    def picture(self, camera: str) -> Picture:
        """Return the last picture that a camera of each vehicle (n,) took, as NumPy arrays outside compiled
        functions."""
        state = whole(self.state)
        world = self.world.with_drawn(state.drawn)
        if isinstance(state.sky.range_error, jax.core.Tracer):
            return picture(world, state, self.number, camera)
        x64 = np.asarray(world.fleets[0].start.position_ned.x).dtype == np.float64
        with jax.enable_x64(bool(x64)):
            found: Picture = jax.tree.map(np.asarray, _developed(world, state, self.number, camera))
        return found

    def taken(self, sensor: str) -> int | Array:
        """Return the tick at which a sensor's last delivered reading was taken, one for all vehicles or (n,)."""
        model, transit = self._delivery(sensor)
        tick = cast(Array, self.tick)
        taken = model.time_of_reading(tick, self.time_step) if transit is None else transit.time_of_reading(tick)
        return cast(int, _on_host(taken))

    def arrived(self, sensor: str) -> bool | Array:
        """Return whether a sensor's reading arrives at the present tick, one for all vehicles or (n,)."""
        model, transit = self._delivery(sensor)
        tick = cast(Array, self.tick)
        return _on_host(model.fresh(tick, self.time_step) if transit is None else transit.fresh(tick))

    def _delivery(self, sensor: str) -> tuple[Sensor, Transit | None]:
        """Return a sensor's model, and its readings that are still delayed (None for a sensor without delay)."""
        number = self.fleet.sensor_names.index(sensor)
        fitted = self.now.fitted[number] if self.now.fitted else None
        return self.fleet.sensors[number], None if fitted is None else fitted.transit

    def record(self, sensor: str) -> Record:
        """Return the last delivered reading of a sensor."""
        return self.now.readings[self.fleet.sensor_names.index(sensor)]

    def withheld(self, sensor: str) -> list[str]:
        """Return, for each vehicle, why a sensor's reading is missing; "" if it is not."""
        violation = self.now.violation
        stopped = [
            f"stopped, {reason_text(int(code), float(value))}" if code else ""
            for code, value in zip(violation.code, violation.value, strict=True)
        ]
        others = zip(self._faults(sensor), self._without_orbits(sensor), strict=True)
        return [why or fault or sky for why, (fault, sky) in zip(stopped, others, strict=True)]

    def _faults(self, sensor: str) -> list[str]:
        """Return, for each vehicle, the fault that suppresses a sensor's readings (the last of several); "" without
        one."""
        found = [""] * self.fleet.size
        for fault, memory in zip(self.fleet.all_faults, self.now.passed_on, strict=True):
            if fault.sensor != sensor:
                continue
            of = "a fault of the scenario" if isinstance(fault, Fault) else "an injected fault"
            active, kinds = np.asarray(fault.active(self.tick)), fault.kinds_of(self.fleet.size)  # type: ignore[arg-type]
            for vehicle in np.flatnonzero(active):
                kind = kinds[vehicle]
                if kind in ("off", "intermittent"):
                    found[vehicle] = f"{kind}, by {of}"
                elif kind in ("stuck", "slow") and memory is not None:
                    leaves = jax.tree.leaves(memory.passed_on)
                    if not all(np.isfinite(leaf[..., vehicle]).all() for leaf in leaves):
                        found[vehicle] = f"{kind}, by {of}, while it had no reading"
        return found

    def _without_orbits(self, sensor: str) -> list[str]:
        """Return, for each vehicle, a text if satellites' orbits are unknown at this time, so that there is no fix;
        else ""."""
        reading = self.record(sensor)
        if not isinstance(reading, GnssReading) or np.isfinite(self.state.sky.satellites_ned.z).any():
            return [""] * self.fleet.size
        why = "no fix: the orbits give no satellite's position at this time"
        return [why if count == 0 else "" for count in np.asarray(reading.satellites)]


def whole(state: State) -> State:
    """Return ``state`` with all its arrays unpacked, if it is one that unpacks on demand."""
    return state.whole() if isinstance(state, Seen) else state


_developed = jax.jit(picture, static_argnums=(2, 3))


def _on_host(value: object) -> Any:
    """Convert an array to NumPy, unless it is traced in a program that is being compiled."""
    return np.asarray(value) if isinstance(value, Array) and not isinstance(value, jax.core.Tracer) else value
