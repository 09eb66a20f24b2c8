"""Concentration sensor (docs/explanation/models/sensors.md)."""

from __future__ import annotations

from typing import ClassVar

from jax import Array

from qrsim.core.noise import Noise
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contents import Surroundings
from qrsim.models.sensors.contracts import Memoryless


@record
class ConcentrationReading:
    """Concentration as measured."""

    concentration: Array = quantity(unit="1", doc="concentration, in the unit of the plume")


@record
class ConcentrationSensor(Memoryless):
    """The concentration at the vehicle, plus white noise."""

    white_std: Array = parameter(default=0.01, unit="1", doc="white noise of each reading", minimum=0.0)
    period: float = setting(
        default=0.5, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "surroundings")
    normals: ClassVar[int] = 1

    def white_noise(self) -> dict[str, Array]:
        """Return the standard deviation of a reading's white noise, {field: std}."""
        return {"concentration": self.white_std}

    def init(self, draw: Noise, position_ned: Vec3, surroundings: Surroundings) -> tuple[None, ConcentrationReading]:
        """Return None as state, and the plume concentration reading (n,) at ``position_ned`` (n,) [m]."""
        smelt = surroundings.concentration(position_ned)
        return None, ConcentrationReading(smelt + self.white_std * draw.normals(1)[0])


@record
class IdealConcentration(Memoryless):
    """The truth at its own period."""

    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "surroundings")

    def init(self, draw: Noise, position_ned: Vec3, surroundings: Surroundings) -> tuple[None, ConcentrationReading]:
        """Return None as state, and the reading: the true plume concentration."""
        return None, ConcentrationReading(surroundings.concentration(position_ned))
