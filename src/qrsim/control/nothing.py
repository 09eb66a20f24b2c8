"""Controller and guidance of vehicles that take no commands."""

from __future__ import annotations

from typing import ClassVar, Literal

from qrsim.control.contracts import Controller
from qrsim.control.guidance import Route, RouteGuidance, RouteState
from qrsim.control.setpoints import Estimate
from qrsim.core.tree import record
from qrsim.models.vehicles.no_command import NoCommand


@record
class NoSetpoint:
    """The set-point of a vehicle that takes no commands: a record without fields."""


@record
class NoController(Controller):
    """No commands, for a vehicle that takes none."""

    setpoints: ClassVar[tuple[type, ...]] = (NoSetpoint,)
    gives: ClassVar[type] = NoCommand
    feed: ClassVar[Literal["truth"]] = "truth"  # type: ignore[misc]

    def init(self, estimate: Estimate) -> None:
        """Return None: the controller has no state."""

    def step(self, state: None, estimate: Estimate, setpoint: NoSetpoint, dt: float) -> tuple[None, NoCommand]:
        """Return None as state, and the empty command of a vehicle that takes no commands."""
        return None, NoCommand()


@record
class NoGuidance(RouteGuidance):
    """No set-points."""

    gives: ClassVar[type] = NoSetpoint

    def setpoint(self, state: RouteState, route: Route) -> NoSetpoint:
        """Return the empty set-point of a vehicle that takes no commands."""
        return NoSetpoint()
