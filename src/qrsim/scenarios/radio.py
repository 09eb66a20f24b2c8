"""The radio of a scenario: its checks, and what is built of it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import record_of, replace
from qrsim.models.radio.channel import FleetRadios
from qrsim.models.radio.network import Network
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.timing import is_multiple

# Bytes of a number of a message.
_NUMBER = 4
# Numbers of a place and a velocity.
_BEACON = 6
# Of a name that readings have for something else.
_INBOX = "inbox"
_MOST_PERIODS = 16


def with_fleets(network: Network | None, scenario: ScenarioSpec) -> Network | None:
    """Return the world's radio network with settings that fleets override filled in; None without a radio."""
    own = [fleet.radio for fleet in scenario.fleets.values()]
    if network is None or all(spec is None for spec in own):
        return network
    sizes = [len(fleet.vehicles) for fleet in scenario.fleets.values()]

    def each(name: str) -> NumpyArray:
        """Return a radio parameter that fleets override, for each vehicle (n,); NaN if not given."""
        values = [np.nan if spec is None or getattr(spec, name) is None else getattr(spec, name) for spec in own]
        return np.repeat(np.array(values, np.float64), sizes)

    works = np.repeat([spec is None or spec.works for spec in own], sizes)
    return replace(
        network, own=record_of(FleetRadios, each("power_dbm"), each("gain_db"), each("noise_figure_db"), works)
    )


def radio_problems(network: Network | None, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of the world's radio network (None: it has none) and of fleets' radio settings."""
    for name, fleet in scenario.fleets.items():
        if fleet.guidance.model_dump().get("knows") == "heard":
            yield from _unheard(f"fleets.{name}", fleet, network)
    if network is None:
        for name, fleet in scenario.fleets.items():
            if fleet.radio is not None:
                yield f"fleets.{name}.radio: there is no world.radio, which it would be a part of"
        return
    for name, fleet in scenario.fleets.items():
        if _INBOX in fleet.sensors:
            yield f"fleets.{name}.sensors.inbox: reading.inbox contains received messages; choose another name"
    size, length = network.size, network.packet.bytes
    if _NUMBER * size > length:
        yield (
            f"world.radio.size: {size} numbers are {_NUMBER * size} bytes, more than a packet of {length} bytes; "
            f"allowed: up to {length // _NUMBER} numbers, or world.radio.packet.bytes of at least {_NUMBER * size}"
        )
    yield from _times(network, scenario.time_step)


def _unheard(path: str, fleet: FleetSpec, network: Network | None) -> Iterator[str]:
    """Yield an error if a fleet's guidance uses only neighbours heard by radio, but the fleet cannot receive."""
    guidance = f"{path}.guidance.knows: 'heard' is by radio"
    if network is None:
        yield f"{guidance}, and there is no world.radio; give one, or knows: all"
    elif fleet.radio is not None and not fleet.radio.works:
        yield f"{guidance}, and {path}.radio is none"
    elif not network.beacon or network.size < _BEACON:
        yield (
            f"{guidance}, which needs beacons of position and velocity; give world.radio beacon: true and a size of at "
            f"least {_BEACON}"
        )


def _times(network: Network, dt: float) -> Iterator[str]:
    """Yield an error if the radio's MAC period is no multiple of ``dt`` [s], or a packet does not fit into a slot."""
    mac, air = network.mac, network.air_time
    path = "world.radio.mac"
    if not is_multiple(mac.period, dt):
        yield f"{path}.period: {mac.period:g} s is not a multiple of the time step {dt:g} s"
        return
    slot = mac.period / mac.slots if mac.type == "tdma" else mac.period
    if air > slot:
        most = math.floor(mac.period / air)
        least = math.ceil(air * (mac.slots if mac.type == "tdma" else 1) / dt - 1e-9) * dt
        what = f"a slot of {path} is {slot:.4g} s" if mac.type == "tdma" else f"{path}.period is {slot:.4g} s"
        slots = f"up to {most} slots, or " if mac.type == "tdma" and most else ""
        yield (
            f"{what}, but a packet of {network.packet.bytes} bytes is {air:.4g} s on the air; allowed: {slots}a period "
            f"of at least {least:.4g} s"
        )
    elif network.periods_on_the_way > _MOST_PERIODS:
        yield (
            f"world.radio.delay: a packet may be on its way for {network.latest:.3g} s, {network.periods_on_the_way} "
            f"periods; allowed: up to {_MOST_PERIODS} periods of {mac.period:g} s"
        )
