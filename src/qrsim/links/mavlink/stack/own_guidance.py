"""A vehicle that goes by the guidance of its scenario: it tells all, and answers each command that it cannot obey."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.codes import FIXED_WING, GROUND_ROVER, Landed, PlanKind, PlanResult, Result, Severity
from qrsim.links.mavlink.stack.commands import KNOWN
from qrsim.links.mavlink.stack.contracts import (
    NEEDED,
    Ack,
    Command,
    Facts,
    FlavourName,
    Heartbeat,
    Item,
    Seen,
    Stack,
    Target,
)
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.links.mavlink.stack.rover_stack import DRIVEN, RoverStack
from qrsim.models.site import Site

# Commands that change nothing of where it goes: DO_SET_HOME, REQUEST of HOME_POSITION.
OBEYED = frozenset((179, 410))
ARM, DO_SET_MODE = 400, 176
# AUTO of ArduPilot's Rover and Plane; its Copter has another number.
AUTO = 10
# A set-point that is refused is said once in so long [s].
SAID_EVERY_S = 5.0
WHY = "goes by its scenario's guidance"


class OwnGuidance(FlightStack):
    """A stack without control of its vehicle, which is armed and in its mission until its run ends.

    The arguments are those of ``FlightStack``.
    """

    takes_setpoints = False

    def reset(self) -> None:
        """Begin again as after a boot."""
        super().reset()
        self.mode, self.armed, self._said_at = Mode.MISSION, True, -SAID_EVERY_S
        self.craft.landed = Landed.IN_AIR if self.facts.mav_type == FIXED_WING else Landed.ON_GROUND

    def tick(self, seen: Seen) -> Order | None:
        """See what there is to see; there is never an order."""
        craft = self.craft
        craft.look(seen)
        self.checks.look(craft)
        if craft.home is None and seen.valid and seen.fix_type >= 3:
            craft.home_here()
        if self.armed and seen.stopped:
            self.armed, craft.landed = False, Landed.ON_GROUND
            craft.say(Severity.EMERGENCY, f"Run has ended: {seen.stopped}")
            craft.tell("armed", 0)
            craft.tell("landed")
        return None

    def command(self, command: Command) -> Ack:
        """Refuse what asks it to go elsewhere."""
        if command.id in OBEYED or command.id not in KNOWN:
            return super().command(command)
        if command.id == ARM and command.params[0] >= 0.5 and self.armed:
            return Ack(Result.ACCEPTED)
        if command.id == DO_SET_MODE:
            numbers = [int(number) if abs(number) < 256.0 else -1 for number in command.params[1:3]]
            return Ack(self.request(self.flavour.mode_of(*numbers)))
        self._refuse(f"Command {command.id}")
        return Ack(Result.DENIED)

    def request(self, mode: Mode | None) -> Result:
        """Refuse any mode but that which it is in."""
        if mode is self.mode:
            return Result.ACCEPTED
        self._refuse("Mode")
        return Result.DENIED

    def setpoint(self, target: Target) -> bool:
        """Refuse a set-point."""
        now = self.craft.seen.time
        if now - self._said_at >= SAID_EVERY_S:
            self._said_at = now
            self._refuse("Set-point")
        return False

    def accept(self, kind: PlanKind, items: Sequence[Item]) -> tuple[PlanResult, int]:
        """Refuse a plan; one without items is none."""
        if not items:
            return PlanResult.ACCEPTED, -1
        self._refuse(kind.name.capitalize())
        return PlanResult.DENIED, 0

    def heartbeat(self) -> Heartbeat:
        """Return what HEARTBEAT and EXTENDED_SYS_STATE say."""
        told = super().heartbeat()
        if self.flavour.name == "ardupilot":
            told.custom_mode = AUTO
        return told

    def _refuse(self, what: str) -> None:
        self.craft.say(Severity.WARNING, f"{what} denied: {WHY}")


def stack_of(flavour: FlavourName = "px4") -> Callable[[Facts, Site], Stack]:
    """Return what makes the stack of a vehicle: one that flies or drives it, or else only tells."""

    def make(facts: Facts, site: Site) -> Stack:
        if facts.mav_type == GROUND_ROVER and facts.kinds >= DRIVEN:
            return RoverStack(facts, site, flavour=flavour)
        kind = FlightStack if facts.kinds >= NEEDED else OwnGuidance
        return kind(facts, site, flavour=flavour)

    return make
