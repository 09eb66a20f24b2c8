"""Schema of faults of sensors, rotors, batteries and radios, and of pushes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from qrsim.files import Content
from qrsim.models.vehicles.fault_numbers import MOST_PUSH, WEAKEST_BATTERY
from qrsim.scenarios.component_schema import Finite, Strict

# Rotors of a fleet that may fail; its mixer is prepared for every set of them.
MOST_FAILED_ROTORS = 4
ALL = "all"


def _in_a_list(value: object) -> object:
    """Return the list ["all"] for the text "all"; any other value unchanged."""
    return [ALL] if value == ALL else value


def _first_rotors(value: object) -> object:
    """Return [0, 1, ...], as many rotors as may fail at most, for "all"; any other value unchanged."""
    return list(range(MOST_FAILED_ROTORS)) if value == ALL else value


def _all_of(value: object) -> object:
    """Return a mapping that makes all parts of a vehicle injectable for "all"; any other value unchanged."""
    return {"sensors": ALL, "rotors": ALL, "battery": True, "radio": True, "body": True} if value == ALL else value


def or_all(schema: Content) -> None:
    """Extend a JSON schema, in place, so that it also allows the word "all"."""
    named = {name: schema.pop(name) for name in ("type", "items", "anyOf", "$ref") if name in schema}
    schema["anyOf"] = [*named.pop("anyOf", []), *([named] if named else []), {"const": ALL}]


class FaultSpec(Strict):
    """A time during which a sensor does not say what it should."""

    type: Literal["sensor"] = Field("sensor", description="target that fails; may be left out")
    sensor: str = Field(description="name of the sensor")
    kind: Literal[
        "off",
        "stuck",
        "wrong",
        "drift",
        "noisy",
        "garbage",
        "slow",
        "delayed",
        "intermittent",
        "lost",
        "frozen",
        "biased",
    ] = Field(description="kind of the fault; lost, frozen and biased are other names of off, stuck and wrong")
    start: Finite = Field(description="start [s]", ge=0)
    end: Finite | None = Field(None, description="end [s]; default: the end of the run", gt=0)
    vehicles: list[str] | None = Field(None, description="names; default: all vehicles of the fleet", min_length=1)
    field: str | None = Field(
        None, description="field that is wrong, drifts, is noisy or garbage: position_ned.x, position_ned for all axes"
    )
    bias: Finite | None = Field(None, description="offset, in the unit of the field (wrong)")
    scale: Finite | None = Field(None, description="factor, applied before the offset (wrong)")
    rate: Finite | None = Field(None, description="offset per second (drift)")
    limit: Finite | None = Field(None, description="the most that is added (drift); default: any number", ge=0)
    std: Finite | None = Field(None, description="standard deviation of the noise of each reading (noisy)", ge=0)
    times: Finite | None = Field(
        None, description="in place of std: factor of the sensor's white noise (noisy)", ge=1, le=1e6
    )
    range: Finite | None = Field(None, description="readings are drawn uniformly from - to + this (garbage)", ge=0)
    every: int | None = Field(
        None, description="number of readings of which one is delivered (slow)", ge=1, le=1_000_000
    )
    by: Finite | None = Field(None, description="how late readings come [s] (delayed)", ge=0, le=600)
    share: Finite | None = Field(None, description="share of the readings that is lost (intermittent)", ge=0, le=1)
    on: Finite | None = Field(None, description="time with readings [s], then without (intermittent)", ge=0, le=1e6)
    off: Finite | None = Field(None, description="time without readings [s] (intermittent)", ge=0, le=1e6)


class RotorFaultSpec(Strict):
    """A rotor that turns slower than commanded from some time on, stops, or is stuck at a speed."""

    type: Literal["rotor"] = Field(description="what fails")
    rotor: int = Field(description="number of the rotor, from 0", ge=0, strict=True)
    at: Finite = Field(description="when [s]", ge=0)
    health: Finite = Field(0.0, description="share of its speed that it still reaches; 0: it stops", ge=0, le=1)
    speed: Finite | None = Field(
        None, description="the part of its largest speed that it is stuck at, in place of health", ge=0, le=1
    )
    end: Finite | None = Field(None, description="when it is well again [s]; default: never", gt=0)
    vehicles: list[str] | None = Field(None, description="names; default: all vehicles of the fleet", min_length=1)


class BatteryFaultSpec(Strict):
    """A battery that loses charge at once, or capacity and voltage for a time."""

    type: Literal["battery"] = Field(description="what fails")
    at: Finite = Field(description="when [s]", ge=0)
    charge: Finite | None = Field(None, description="what is left of a full charge", ge=0, le=1)
    health: Finite | None = Field(None, description="what is left of capacity and voltage", ge=WEAKEST_BATTERY, le=1)
    end: Finite | None = Field(None, description="when capacity and voltage are back [s]; default: never", gt=0)
    vehicles: list[str] | None = Field(None, description="names; default: all vehicles of the fleet", min_length=1)


class RadioFaultSpec(Strict):
    """A time during which radios are off, or lose more packets than they should."""

    type: Literal["radio"] = Field(description="what fails")
    kind: Literal["off", "weak"] = Field(description="off: nothing is sent or received; weak: a share is lost")
    at: Finite = Field(description="start [s]", ge=0)
    end: Finite | None = Field(None, description="end [s]; default: the end of the run", gt=0)
    share: Finite | None = Field(
        None, description="part of the packets, sent and received, that is lost in addition (weak)", ge=0, le=1
    )
    vehicles: list[str] | None = Field(None, description="names; default: all vehicles of the fleet", min_length=1)

    @model_validator(mode="after")
    def _share_if_weak(self) -> RadioFaultSpec:
        """Refuse a radio fault of kind "weak" without a share, and a share for any other kind."""
        if (self.kind == "weak") != (self.share is not None):
            raise ValueError(
                "share is missing; kind 'weak' needs it" if self.kind == "weak" else "share is for kind 'weak' only"
            )
        return self


_Push = Annotated[Finite, Field(ge=-MOST_PUSH, le=MOST_PUSH)]
Push3 = Annotated[list[_Push], Field(min_length=3, max_length=3)]


class PushSpec(Strict):
    """A push: a force per mass for a time."""

    type: Literal["body"] = Field(description="what is pushed")
    at: Finite = Field(description="start [s]", ge=0)
    end: Finite | None = Field(None, description="end [s]; default: the end of the run", gt=0)
    acceleration_ned: Push3 | None = Field(None, description="north, east, down [m/s^2]")
    acceleration_body: Push3 | None = Field(
        None, description="forward, right, down in body axes [m/s^2], in place of acceleration_ned or in addition"
    )
    vehicles: list[str] | None = Field(None, description="names; default: all vehicles of the fleet", min_length=1)


class InjectableSpec(Strict):
    """Parts of a fleet's vehicles that may be made to fail in flight; they are compiled, and cost a little."""

    sensors: Annotated[list[str], BeforeValidator(_in_a_list)] = Field(
        [], description="names of sensors, or all", json_schema_extra=or_all
    )
    rotors: Annotated[list[Annotated[int, Field(ge=0, strict=True)]], BeforeValidator(_first_rotors)] = Field(
        [],
        description="numbers of rotors, from 0, at most four, or all, of which the first four",
        json_schema_extra=or_all,
    )
    battery: bool = Field(False, description="the battery can be made to lose charge", strict=True)
    radio: bool = Field(False, description="the radio may fail", strict=True)
    body: bool = Field(False, description="the vehicles can be pushed", strict=True)
    delay_max: Finite = Field(0.0, description="longest delay of kind delayed [s]", ge=0, le=60)


InjectableModel = Annotated[InjectableSpec, BeforeValidator(_all_of)]


_TYPES: dict[str, type[Strict]] = {
    "sensor": FaultSpec,
    "rotor": RotorFaultSpec,
    "battery": BatteryFaultSpec,
    "radio": RadioFaultSpec,
    "body": PushSpec,
}


def _what_fails(fault: object) -> str:
    """Return the type of a fault in a scenario, such as "rotor" or "body"; "sensor" if it is left out."""
    if isinstance(fault, dict):
        fault_type = fault.get("type", "sensor")
        return fault_type if isinstance(fault_type, str) else "sensor"
    return next(name for name, spec in _TYPES.items() if isinstance(fault, spec))


AnyFault = Annotated[
    Annotated[FaultSpec, Tag("sensor")]
    | Annotated[RotorFaultSpec, Tag("rotor")]
    | Annotated[BatteryFaultSpec, Tag("battery")]
    | Annotated[RadioFaultSpec, Tag("radio")]
    | Annotated[PushSpec, Tag("body")],
    Discriminator(_what_fails),
]
