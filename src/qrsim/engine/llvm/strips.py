"""Which steps of one world's tick go through its vehicles strip by strip.

A strip is some hundred elements of the last axis. Steps that need no other element than their own form a group: all of
them run on one strip before the next, so that arrays between them stay in the core's own cache, and threads share the
strips. Between two groups are the steps that couple elements, such as sums over all of them or the nearest other one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod

from qrsim.engine.llvm.graph import Access, Node, Shape
from qrsim.engine.llvm.in_state import Move
from qrsim.engine.llvm.schedule import Reading, Step, all_nodes
from qrsim.engine.llvm.writing import Place

# A sum over all elements has its own loop if at least this many operations come before it.
_WORTH_A_STRIP = 8
# What is as small as this is computed again for every strip.
_SMALL = 1024


@dataclass(frozen=True)
class Late:
    """Copies to the state at the end of a tick: of a group, or of none (0)."""

    group: int
    moves: list[Move]


class Grouping:
    """Puts steps into groups, in an order in which they can be computed.

    Args:
        strip: elements of a strip; longer last axes are cut. 0: none is.
        leaves: numbers of the nodes of the state.

    Attributes:
        extents: of the last axis that each group cuts.
    """

    def __init__(self, strip: int, leaves: set[int]):
        self.strip, self.leaves = strip, leaves
        self.extents: dict[int, int] = {}

    def of(self, steps: Sequence[Step]) -> list[Step]:
        """Reorder steps so that those of a group, which run strip by strip, are adjacent, and number the groups."""
        steps = [part for step in steps for part in self._parted(step)]
        order = _Order(steps)
        found: list[Step] = []
        while order.ready:
            step = self._alone(order)
            if step is not None:
                found.append(step)
                continue
            made: set[int] = set()
            extent = self._extent(order.first())
            group = self._new_group(extent)
            while (step := self._next(order, extent, made)) is not None:
                step.group = group
                found.append(step)
        return found

    def _new_group(self, extent: int) -> int:
        """Add a group of steps that are cut into strips along an axis of this length, and return its number."""
        self.extents[len(self.extents) + 1] = extent
        return len(self.extents)

    def late(self, moves: list[Move], body: Sequence[Step], places: Mapping[int, Place]) -> list[Late]:
        """Return the copies to the state (``moves``) at a tick's end by the group of strips they run in (0: none)."""
        if not self.strip:
            return [Late(0, moves)]
        sets: dict[int, list[Move]] = {}
        made = {node.number for node in all_nodes(body) if node.shape and node.shape[-1] > self.strip}
        for move in moves:
            access, shape, _ = move
            extent = shape[-1] if shape and shape[-1] > self.strip else 0
            sets.setdefault(extent if self._own(access, shape, extent, made) else 0, []).append(move)
        last = body[-1].group if body else 0
        found, begun = [], self.extents.get(last, 0)
        for extent in sorted(sets, key=lambda extent: (extent != begun, extent == 0)):
            group = 0 if extent == 0 else last if extent == begun else self._new_group(extent)
            found.append(Late(group, sets[extent]))
        return found if _independent(found, places) else [Late(0, moves)]

    def _alone(self, order: _Order) -> Step | None:
        """Return the next step in ``order`` that is not cut into strips, scalars first; None if there is none."""
        for wanted in (lambda step: step.domain == () and step.kind == "loop", lambda step: not self._fits_alone(step)):
            for i in order.ready:
                if wanted(order.steps[i]):
                    return order.take(i)
        return None

    def _fits_alone(self, step: Step) -> bool:
        """Return whether a step can be cut into strips in a group that has no other steps."""
        extent = self._extent(step)
        return extent > 0 and self._fits(step, extent, set())

    def _next(self, order: _Order, extent: int, made: set[int]) -> Step | None:
        """Return the next step in ``order`` that fits a group (axis of length ``extent``, nodes ``made``); or None."""
        for i in order.ready:
            step = order.steps[i]
            if self._extent(step) == extent and self._fits(step, extent, made):
                made |= _made(step, extent)
                return order.take(i)
        return None

    def _extent(self, step: Step) -> int:
        """Return the length of the axis along which a step can be cut into strips; 0 if it cannot be cut."""
        if step.kind == "cond":
            shapes = {node.shape[-1:] for node in step.nodes[1:]}
            shape = shapes.pop() if len(shapes) == 1 else ()
        else:
            shape = step.domain[-1:] if step.kind in ("loop", "rows", "concatenate", "running") else ()
        return shape[0] if shape and shape[0] > self.strip else 0

    def _parted(self, step: Step) -> list[Step]:
        """Split a loop that ends in sums over all elements into the elementwise loop and the sums."""
        last = len(step.domain) - 1
        if step.kind != "loop" or last not in step.reduced or step.domain[-1] <= self.strip:
            return [step]
        sums = [node for node in step.nodes if node.op == "reduce"]
        others = [node for node in step.nodes if node.op != "reduce"]
        if len(others) < _WORTH_A_STRIP:
            return [step]
        first = replace(step, nodes=others, kept=tuple(range(last + 1)), reduced=())
        return [first, replace(step, nodes=sums)]

    # What can be cut

    def _fits(self, step: Step, extent: int, made: set[int]) -> bool:
        """Return whether a step, cut into strips, reads only its own elements of nodes of its group (``made``)."""
        return self._fits_inside(step, extent, made | _made(step, extent))

    @staticmethod
    def _cuts(step: Step) -> bool:
        """Return whether the loop of a step can be cut into strips along its last axis."""
        last = len(step.domain) - 1
        if step.kind == "rows":
            return True
        if step.kind == "loop":
            return last not in step.reduced
        return step.kind in ("concatenate", "running") and step.nodes[0].attributes[0] != last

    def _fits_inside(self, step: Step, extent: int, made: set[int]) -> bool:
        """Return whether a step inside a branch can be computed for one strip only (``made``: nodes of its group)."""
        if step.kind == "cond":
            outputs = [(node, region.results[node.attributes[0]]) for region in step.nodes[0].regions
                       for node in step.nodes[1:]]  # fmt: skip
            return (
                all(self._whole(access, extent, made) for access in step.nodes[0].args)
                and all(self._own(access, node.shape, extent, made) for node, access in outputs)
                and all(self._fits_inside(inner, extent, made) for branch in step.branches for inner in branch)
            )
        if step.kind not in ("loop", "rows", "concatenate", "running"):
            return False
        if step.domain[-1:] == (extent,):
            return self._cuts(step) and all(self._reads_own(node, extent, made) for node in step.nodes)
        small = prod(step.domain) <= _SMALL
        return small and all(self._reads_own(node, extent, made) for node in step.nodes)

    def _reads_own(self, node: Node, extent: int, made: set[int]) -> bool:
        """Return whether a node's loop reads only its own elements of the nodes that its group computes (``made``)."""
        return all(self._own(access, shape, extent, made, moved) for access, shape, moved in _reads(node))

    def _own(self, access: Access, shape: Shape, extent: int, made: set[int], moved: bool = False) -> bool:
        """Return whether a loop over ``shape`` reads its own element of the last axis, or an unchanged array."""
        last = len(shape) - 1
        followed = [axis for axis, _ in access.index]
        along = (
            shape[-1:] == (extent,) == access.node.shape[-1:]
            and access.index[-1] == (last, 0)
            and followed.count(last) == 1
            and not moved
        )
        return along or self._whole(access, extent, made)

    def _whole(self, access: Access, extent: int, made: set[int]) -> bool:
        """Return whether all elements of an array may be read, because its group (``made``) does not change it."""
        node = access.node
        return node.number not in made and not (node.number in self.leaves and node.shape[-1:] == (extent,))


class _Order:
    """Steps that are not taken yet.

    Args:
        steps: in an order in which they can be computed.

    Attributes:
        ready: places of those that can be computed now.
    """

    def __init__(self, steps: list[Step]):
        self.steps = steps
        made = {node.number: i for i, step in enumerate(steps) for node in step.nodes}
        self._missing = [
            {made[access.node.number] for _, access in step.accesses if access.node.number in made} - {i}
            for i, step in enumerate(steps)
        ]
        self._readers: list[list[int]] = [[] for _ in steps]
        for i, missing in enumerate(self._missing):
            for other in missing:
                self._readers[other].append(i)
        self.ready = [i for i, missing in enumerate(self._missing) if not missing]

    def first(self) -> Step:
        """Return the first step of which all inputs have been computed."""
        return self.steps[self.ready[0]]

    def take(self, which: int) -> Step:
        """Remove and return ready step number ``which``; steps that waited only for it become ready."""
        self.ready.remove(which)
        for reader in self._readers[which]:
            self._missing[reader].discard(which)
            if not self._missing[reader]:
                self.ready.append(reader)
        self.ready.sort()
        return self.steps[which]


class Lifetimes:
    """Where values of a tick are read, and until when.

    Args:
        body: the steps, in their groups.
        read: who reads each node, as of ``schedule.readers``; the results are read behind the last step.
        late: copies to the state.
    """

    def __init__(self, body: Sequence[Step], read: Mapping[int, Sequence[Reading]], late: Sequence[Late]):
        self._groups, self._read = [step.group for step in body], read
        # The last step of the group of each one.
        self._until = list(range(len(body)))
        for i in reversed(range(len(body) - 1)):
            if self._groups[i] and self._groups[i] == self._groups[i + 1]:
                self._until[i] = self._until[i + 1]
        # Every thread computes scalars, and may read them when another one is ahead of it.
        scalars = [step for step in body if step.domain == () and step.kind == "loop"] if any(self._groups) else []
        self._kept = {access.node.number for step in scalars for _, access in step.accesses}
        self._moved = [{access.node.number for access, _, _ in each.moves} for each in late]
        self._late = [each.group for each in late]

    def local(self, node: Node, at: int) -> bool:
        """Return whether only the group of step number ``at`` reads the node that this step computes."""
        group = self._groups[at]
        return group > 0 and all(
            self._groups[i] == group if i < len(self._groups) else self._moved_within(node, group)
            for i, _, _ in self._read.get(node.number, ())
        )

    def _moved_within(self, node: Node, group: int) -> bool:
        """Return whether all copies of a node to the state run in the strips of this group."""
        return all(
            each == group for each, numbers in zip(self._late, self._moved, strict=True) if node.number in numbers
        )

    def end(self, node: Node, at: int, local: bool) -> int:
        """Return the step after which memory of a node of step ``at`` is free; ``local``: only its group reads it."""
        last = max(at, *(i for i, _, _ in self._read.get(node.number, ())), at)
        if node.number in self._kept or last >= len(self._until):
            return len(self._until)
        return last if local else self._until[last]


def _independent(late: Sequence[Late], places: Mapping[int, Place]) -> bool:
    """Return whether no set of copies to the state (``late``) reads an array that another set writes."""
    written = [{(to.pointer, to.offset) for _, _, to in each.moves} for each in late]
    for i, each in enumerate(late):
        elsewhere = set().union(*(targets for j, targets in enumerate(written) if j != i))
        for access, _, _ in each.moves:
            place = places.get(access.node.number)
            if place is not None and (place.pointer, place.offset) in elsewhere:
                return False
    return True


def strip_pointer(group: int, element: int) -> str:
    """Return the name of a pointer to a thread's strip, offset as for element 0 (of ``element`` bytes) of the array."""
    return f"%local{group}.{element}"


def _made(step: Step, extent: int) -> set[int]:
    """Return the numbers of the nodes with a last axis of this length that a step computes, branches included."""
    found = {node.number for node in step.nodes if node.shape[-1:] == (extent,)}
    return found.union(*(_made(inner, extent) for branch in step.branches for inner in branch))


def _reads(node: Node) -> Iterator[tuple[Access, Shape, bool]]:
    """Yield each access of a node, the shape of the reading loop, and whether it picks along the last axis."""
    if node.op == "concatenate":
        for access, shape in zip(node.args, node.attributes[2], strict=True):
            yield access, shape, False
        return
    for i, access in enumerate(node.args):
        yield access, node.domain, node.op == "pick" and i == 0 and node.attributes[0][-1] is not None
