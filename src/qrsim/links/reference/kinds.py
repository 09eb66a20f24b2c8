"""Kinds of set-points and commands on the wire, and as orders."""

from __future__ import annotations

from qrsim.errors import UsageError
from qrsim.links.contracts import Order
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Step
from qrsim.links.shared.kinds import CONTROL, FIELDS

# Number of a kind in STEP and COMMAND -> its name as an order. VEL is a velocity at a heading of 0.
KINDS: dict[int, str] = {
    Step.WP: "waypoint",
    Step.CTRL: CONTROL,
    Step.VEL: "velocity",
    Step.VEL_YAW: "velocity",
    Step.VEL_HEIGHT: "velocity_height",
    Step.ATT_HEIGHT: "attitude_height",
    Step.ATT: "attitude",
    Step.PATH: "path",
    Step.TRACK: "track",
}
# By which a kind goes by its name.
TYPES: dict[str, int] = {name: number for number, name in KINDS.items() if number != Step.VEL}
# Numbers for each vehicle; those of a command are the vehicle's own, a quadrotor's here.
WIDTHS = {number: len(FIELDS[name]) for number, name in KINDS.items() if name in FIELDS} | {Step.VEL: 3, Step.CTRL: 5}


def order_of(request: pb.Order) -> Order:
    """Convert a protobuf order to an ``Order`` record.

    Raises:
        UsageError: its text is none, or a velocity has not three numbers.
    """
    if not isinstance(request.vehicle, str):
        raise UsageError("message: a text is not UTF-8")
    numbers = tuple(request.cmd.value)
    if request.type == Step.VEL:
        if len(numbers) != WIDTHS[Step.VEL]:
            raise UsageError(f"'{request.vehicle[:60]}': velocity: {len(numbers)} numbers; expected 3, or VEL_YAW")
        numbers = (*numbers, 0.0)
    return Order(request.vehicle, KINDS[request.type], numbers)
