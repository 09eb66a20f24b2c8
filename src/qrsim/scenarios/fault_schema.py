"""What a scenario says of faults: of sensors, and of rotors."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import (
    Discriminator,
    Field,
    Tag,
)

from qrsim.scenarios.component_schema import Finite, Strict


class FaultSpec(Strict):
    """A time during which the readings of a sensor are lost, frozen or biased."""

    type: Literal["sensor"] = Field("sensor", description="what fails; may be left out")
    sensor: str = Field(description="name of the sensor")
    kind: Literal["lost", "frozen", "biased"] = Field(description="what happens to its readings")
    start: Finite = Field(description="start [s]", ge=0)
    end: Finite | None = Field(None, description="end [s]; default: the end of the run", gt=0)
    vehicles: list[str] | None = Field(None, description="names; default: all vehicles of the fleet", min_length=1)
    field: str | None = Field(None, description="what is biased, for example position_ned.x or height")
    bias: Finite | None = Field(None, description="what is added, in the unit of the field")


class RotorFaultSpec(Strict):
    """A rotor that turns slower than it is told from some time on, or stands still."""

    type: Literal["rotor"] = Field(description="what fails")
    rotor: int = Field(description="number of the rotor, from 0", ge=0, strict=True)
    at: Finite = Field(description="when [s]", ge=0)
    health: Finite = Field(
        0.0, description="the part of its speed that it still reaches; 0: it stands still", ge=0, le=1
    )
    vehicles: list[str] | None = Field(None, description="names; default: all vehicles of the fleet", min_length=1)


def _what_fails(fault: object) -> str:
    """Return the type of a fault as a scenario writes it; those of sensors need not say it."""
    if isinstance(fault, dict):
        fault_type = fault.get("type", "sensor")
        return fault_type if isinstance(fault_type, str) else "sensor"
    return "rotor" if isinstance(fault, RotorFaultSpec) else "sensor"


AnyFault = Annotated[
    Annotated[FaultSpec, Tag("sensor")] | Annotated[RotorFaultSpec, Tag("rotor")], Discriminator(_what_fails)
]
