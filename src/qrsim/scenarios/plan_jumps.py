"""DO_JUMP of QGroundControl plans: from items in the order of the file to items in the order of flight.

As in PX4 and ArduPilot, a jump leads to its target so many times, and an outer loop does not set its count back. The
target is a ``doJumpId`` of the file; of items without one, their number.
"""

from __future__ import annotations

from dataclasses import dataclass

from qrsim.files import Content
from qrsim.scenarios.plan_parts import PlanFaultError, number_of, part_of

JUMP = 177
# A plan may go through so many items, repeats included.
MOST_STEPS = 20_000
_MOST_REPEATS = 1e9


@dataclass(frozen=True)
class SimpleItem:
    """A simple item of a plan.

    Attributes:
        number: from 1, as QGroundControl shows it.
        path: of the item in the file.
        content: of it.
    """

    number: int
    path: str
    content: Content

    @property
    def jumps(self) -> bool:
        """Whether it is a jump."""
        return self.content.get("command") == JUMP


@dataclass(frozen=True)
class Flight:
    """Items in the order of flight.

    Attributes:
        items: those that are flown, without the jumps.
        again: index of the item that follows the last one; None: none does.
        jump: the one that repeats for ever, None where none does.
        unreached: numbers of the items that are never flown.
    """

    items: list[SimpleItem]
    again: int | None
    jump: SimpleItem | None
    unreached: set[int]


def in_order(items: list[SimpleItem]) -> Flight:
    """Return items in the order of flight; a jump for ever is followed once, and then leads to ``again``.

    Raises:
        PlanFaultError: a jump that leads nowhere, or repeats too often.
    """
    goals = {i: _goal(items, item) for i, item in enumerate(items) if item.jumps}
    order: list[SimpleItem] = []
    left = {i: repeats for i, (_, repeats) in goals.items()}
    # Of each jump for ever: how many items were flown, and jumps counted, when it was reached.
    reached: dict[int, tuple[int, int]] = {}
    i = steps = counted = 0
    while i < len(items):
        steps += 1
        if steps > MOST_STEPS:
            raise PlanFaultError(f"{items[i].path}: jumps lead through more than {MOST_STEPS} items")
        if i not in goals:
            order.append(items[i])
            i += 1
        elif left[i] < 0:
            if i in reached and reached[i][1] == counted:
                return _endless(items, order, reached[i][0], items[i])
            reached[i] = len(order), counted
            i = goals[i][0]
        elif left[i] > 0:
            left[i] -= 1
            counted += 1
            i = goals[i][0]
        else:
            i += 1
    return Flight(order, None, None, set())


def _endless(items: list[SimpleItem], order: list[SimpleItem], again: int, jump: SimpleItem) -> Flight:
    flown = {item.number for item in order}
    unreached = {item.number for item in items if not item.jumps} - flown
    return Flight(order, again, jump, unreached)


def _goal(items: list[SimpleItem], jump: SimpleItem) -> tuple[int, int]:
    """Return the index of the item that a jump leads to, and its repeats, below 0 for ever."""
    params: list[object] = part_of(jump.content, "params", list, jump.path)
    if len(params) < 2:
        raise PlanFaultError(f"{jump.path}.params: expected 7 values, found {len(params)}")
    target, repeats = (number_of(params[i], f"{jump.path}.params.{i}", _MOST_REPEATS, "") for i in (0, 1))
    names = [item.content.get("doJumpId", item.number) for item in items]
    if target not in names:
        raise PlanFaultError(
            f"{jump.path}.params.0: {target:g} is the doJumpId of no item; there: {', '.join(map(str, names[:20]))}"
        )
    return names.index(target), int(repeats)
