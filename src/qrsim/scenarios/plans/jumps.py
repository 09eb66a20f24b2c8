"""DO_JUMP: from items in the order of the file to items in the order of flight.

As in PX4 and ArduPilot, a jump leads to its target a number of times, and an outer loop does not set its count back.
The target is a ``doJumpId`` of a .plan file; of items without one, their number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from qrsim.files import Content
from qrsim.scenarios.plans.commands import JUMP, PLACES, RETURN
from qrsim.scenarios.plans.parts import PlanFaultError, number_of, part_of

# Legs after jumps are unrolled, and items that are looked at while they are.
MOST_LEGS, MOST_STEPS = 2000, 1_000_000
_MOST_REPEATS = 1e9
# Numbers in one message.
_SHOWN = 20


@dataclass(frozen=True)
class SimpleItem:
    """A simple item of a plan.

    Attributes:
        number: from 1, as QGroundControl shows it.
        path: of the item in the file.
        content: of it.
        side_deg: heading relative to the way [deg], of items of a scan; None: none.
    """

    number: int
    path: str
    content: Content
    side_deg: float | None = None

    @property
    def jumps(self) -> bool:
        """True if the mission item is a DO_JUMP."""
        return self.content.get("command") == JUMP

    @property
    def flies(self) -> bool:
        """True if the mission item leads the vehicle to a place."""
        return self.content.get("command") in PLACES or self.content.get("command") == RETURN


@dataclass(frozen=True)
class Flight:
    """Items in the order of flight.

    Attributes:
        items: those that are flown, without the jumps.
        again: index of the item that follows the last one; None: none does.
        jump: the one that repeats endlessly, None where none does.
    """

    items: list[SimpleItem]
    again: int | None = None
    jump: SimpleItem | None = None


def in_order(items: Sequence[SimpleItem]) -> Flight:
    """Return mission items in flight order with jumps unrolled; an endless jump becomes the index to repeat from.

    Raises:
        PlanFaultError: a jump leads nowhere or to itself, jumps repeat too often or lead to each other only, or an item
            follows an endless jump.
    """
    goals = {i: _goal(items, i) for i, item in enumerate(items) if item.jumps}
    left = {i: repeats for i, (_, repeats) in goals.items()}
    order: list[SimpleItem] = []
    # Of each endless jump: how many items were flown, and jumps counted, when it was reached.
    reached: dict[int, tuple[int, int]] = {}
    i = steps = counted = legs = 0
    while i < len(items):
        steps += 1
        if i not in goals:
            legs += items[i].flies
            if legs <= MOST_LEGS or not goals:
                order.append(items[i])
            i += 1
        elif left[i] == 0:
            i += 1
        else:
            if left[i] < 0 and i in reached and reached[i][1] == counted:
                _check_loop(items, order, reached[i][0], i)
                _check_count(legs, items[i])
                return Flight(order, reached[i][0], items[i])
            if left[i] < 0:
                reached[i] = len(order), counted
            else:
                left[i] -= 1
                counted += 1
            i = goals[i][0]
        if steps > MOST_STEPS:
            raise PlanFaultError(f"{_first(items, goals)}: more than {MOST_STEPS} items when unrolled; {_ALLOWED}")
    if goals and legs > MOST_LEGS:
        raise PlanFaultError(f"{_first(items, goals)}: {legs} legs when unrolled; {_ALLOWED}")
    return Flight(order)


_ALLOWED = f"allowed: {MOST_LEGS}"


def _first(items: Sequence[SimpleItem], goals: dict[int, tuple[int, int]]) -> str:
    """Return the file path of the jump with the most repeats, for a message; ``goals``: jump -> (target, repeats)."""
    return f"{items[max(goals, key=lambda i: goals[i][1])].path} (DO_JUMP)"


def _check_count(legs: int, jump: SimpleItem) -> None:
    """Raise PlanFaultError if a mission has more than MOST_LEGS legs once its jumps are unrolled."""
    if legs > MOST_LEGS:
        raise PlanFaultError(f"{jump.path} (DO_JUMP): {legs} legs when unrolled; {_ALLOWED}")


def _check_loop(items: Sequence[SimpleItem], order: list[SimpleItem], again: int, at: int) -> None:
    """Raise PlanFaultError if an endless jump repeats only items without a place, or has items after it."""
    jump = items[at]
    if not any(item.flies for item in order[again:]):
        raise PlanFaultError(f"{jump.path} (DO_JUMP): repeats endlessly without an item that leads to a place")
    flown = {item.number for item in order}
    for item in items:
        if not item.jumps and item.number not in flown:
            raise PlanFaultError(
                f"{item.path}: is never reached, because DO_JUMP (item {jump.number}) repeats endlessly"
            )


def _goal(items: Sequence[SimpleItem], at: int) -> tuple[int, int]:
    """Return the index of the target of the jump at index ``at``, and its number of repeats (below 0: endless)."""
    jump = items[at]
    params: list[object] = part_of(jump.content, "params", list, jump.path)
    if len(params) < 2:
        raise PlanFaultError(f"{jump.path}.params: expected 7 values, found {len(params)}")
    target, repeats = (number_of(params[i], f"{jump.path}.params.{i}", _MOST_REPEATS, "") for i in (0, 1))
    names = [item.content.get("doJumpId", item.number) for item in items]
    if target not in names:
        raise PlanFaultError(f"{jump.path}.params.0: no item has doJumpId {target:g}; known: {_known(names)}")
    goal = names.index(target)
    if goal == at and repeats:
        raise PlanFaultError(f"{jump.path} (DO_JUMP): jumps to itself")
    return goal, int(repeats)


def _known(names: list[object]) -> str:
    """Return the ids of mission items as text for a message, as a range if possible."""
    if len(names) > 1 and all(isinstance(name, int) for name in names):
        whole: list[int] = sorted(name for name in names if isinstance(name, int))
        if whole == list(range(whole[0], whole[0] + len(whole))):
            return f"{whole[0]} to {whole[-1]}"
    more = ", ..." if len(names) > _SHOWN else ""
    return ", ".join(str(name) for name in names[:_SHOWN]) + more
