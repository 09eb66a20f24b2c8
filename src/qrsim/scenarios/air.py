"""Checks and warnings of turbulence and gusts that the wind carries."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from qrsim.core.host import on_host
from qrsim.errors import UsageError
from qrsim.models.atmosphere.contracts import CONVECTION_HEIGHT
from qrsim.models.atmosphere.field_modes import GROUPS
from qrsim.scenarios.build import wind_of
from qrsim.scenarios.schema import ScenarioSpec

FIELD = "dryden_field"
# A field slower than this stands still for a vehicle that hovers for a minute: its gusts would be a steady wind [m/s].
SLOWEST = 0.5
# Unless its waves live no longer than this [s].
LONGEST = 200.0


def air_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors in a scenario's turbulence and discrete gust, one sentence each."""
    turbulence, gust = scenario.world.turbulence, scenario.world.gust
    if turbulence.type == FIELD:
        chains, multiple = turbulence.chains, 2 * GROUPS
        if chains % multiple:
            low = chains // multiple * multiple
            yield (
                f"world.turbulence.chains: {chains}; allowed: a multiple of {multiple}, the nearest are {low} and "
                f"{low + multiple}"
            )
        if turbulence.residual == "filter" and turbulence.spectrum != "dryden":
            yield (
                f"world.turbulence.residual: 'filter' continues the Dryden form only, and the spectrum is "
                f"'{turbulence.spectrum}'; allowed: none"
            )
    if gust.type == "discrete":
        if gust.speed is None and gust.front == "uniform":
            yield "world.gust.speed: missing (at which vehicles cross it, m/s; only a travelling gust has the wind's)"
        elif (gust.speed is None or gust.wind_from_rad is None) and convection_speed(scenario) == 0.0:
            name = "speed" if gust.speed is None else "wind_from_deg"
            yield (
                f"world.gust.{name}: missing; it would be that of the wind that carries the turbulence, which is zero"
            )


def air_warnings(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a warning if the gust field hardly moves or changes, so that a hovering vehicle meets a steady wind."""
    turbulence = scenario.world.turbulence
    if turbulence.type != FIELD or _speed_20ft(scenario) <= 0.0:
        return
    speed = convection_speed(scenario)
    frozen = turbulence.evolution == "frozen"
    if speed + turbulence.sweep < SLOWEST and (frozen or turbulence.lifetime > LONGEST):
        lasting = "it is frozen" if frozen else f"its waves have a lifetime of {turbulence.lifetime:g} s"
        yield (
            f"world.turbulence: the field moves at {speed:.3g} m/s, its sweep is {turbulence.sweep:g} m/s and "
            f"{lasting}, so a vehicle that hovers meets a steady wind in place of gusts; give "
            f"convection_ned, sweep or a lifetime of at most {LONGEST:g}"
        )


_mean = on_host(lambda wind, height: wind.mean_velocity_ned(height))


def convection_speed(scenario: ScenarioSpec) -> float:
    """Return the wind speed [m/s] that carries the gust field along; infinite if the wind's file is unreadable."""
    turbulence = vars(scenario.world.turbulence)
    given = turbulence.get("convection_ned")
    if given is not None:
        return math.hypot(*given)
    try:
        wind = wind_of(scenario)
    except UsageError:
        return math.inf
    height = np.full(1, turbulence.get("convection_height", CONVECTION_HEIGHT), np.float32)
    mean = _mean(wind, height)
    return math.hypot(float(mean.x[0]), float(mean.y[0]))


def _speed_20ft(scenario: ScenarioSpec) -> float:
    """Return the mean wind speed [m/s] at 20 ft that the turbulence gives, else the wind, else 0."""
    own = vars(scenario.world.turbulence).get("speed_20ft")
    return float(own if own is not None else vars(scenario.world.wind).get("speed_20ft", 0.0))
