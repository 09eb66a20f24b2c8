"""Schema of a scenario's changes of the weather, and of pushes, at set times and in flight."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, create_model

from qrsim.scenarios.component_schema import Finite, Strict
from qrsim.scenarios.fault_schema import ALL, Push3
from qrsim.simulation.changing import JAM, TAKES

MOST_EVENTS = 50
_OVER: Any = Field(0.0, description="duration of the change, which is linear [s]; 0: at once", ge=0, le=1e6)


class WindEvent(Strict):
    """Another mean wind."""

    speed_20ft: Finite | None = Field(None, description="speed 20 ft above the ground [m/s]; default: unchanged", ge=0)
    wind_from_deg: Finite | None = Field(
        None, description="bearing the wind comes from [deg], reached by the shorter turn; default: unchanged"
    )
    over: Finite = _OVER


class GustsEvent(Strict):
    """Random gusts of another strength."""

    times: Finite = Field(description="factor of the scenario's gusts", ge=0, le=10)
    over: Finite = _OVER


class JamEvent(Strict):
    """Another power of a jammer of the scenario."""

    jammer: int = Field(description="which one of the jammers in interference, from 0", ge=0, strict=True)
    power_w: Finite = Field(description="power that it radiates [W]", ge=0, le=1e6)
    over: Finite = _OVER


# ``for`` is a word of Python, so that a class cannot declare it.
_LASTS: Any = {"for": (Finite, Field(description="duration [s], a multiple of the time step", gt=0, le=1e6))}
PushEvent: Any = create_model(
    "PushEvent",
    __base__=Strict,
    __doc__="A push of some vehicles, a force per mass.",
    acceleration_ned=(Push3 | None, Field(None, description="north, east, down [m/s^2]")),
    acceleration_body=(
        Push3 | None,
        Field(
            None, description="forward, right, down in body axes [m/s^2], in place of acceleration_ned or in addition"
        ),
    ),
    **_LASTS,
    vehicles=(list[str] | None, Field(None, description="names; default: all that can be pushed", min_length=1)),
)


class EventSpec(Strict):
    """An event at a time: a change of the weather (wind, gusts or jam), or a push of vehicles."""

    at: Finite = Field(description="when [s], a multiple of the time step", ge=0)
    wind: WindEvent | None = Field(None, description="another mean wind, of type log_shear or veering_shear")
    gusts: GustsEvent | None = Field(None, description="random gusts of another strength")
    jam: JamEvent | None = Field(None, description="another power of a jammer")
    push: PushEvent | None = Field(None, description="a push of vehicles")


def _every_kind(value: object) -> object:
    """Return the list of all kinds of event that can be injected for "all"; any other value unchanged."""
    return list(TAKES) if value == ALL else value


Changeable = Annotated[list[Literal["wind", "gusts", "jam"]], BeforeValidator(_every_kind)]


def may_be_jammed(scenario: Any) -> bool:
    """Return whether jammers' power may change in flight, so that jammers without power must be built too."""
    world = scenario.world
    return JAM in world.injectable or any(event.jam is not None for event in world.events)
