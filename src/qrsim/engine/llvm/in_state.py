"""Which arrays are computed where the state lies, so that nothing need be copied there, or there and back.

A leaf of the state may be overwritten as soon as nobody reads what it was. What a branching hands out of it unchanged,
as the reading of a slow sensor between two of its times, stays where it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from qrsim.engine.llvm.graph import Access, Node, Shape
from qrsim.engine.llvm.schedule import Reading, Step, branch_results, readers
from qrsim.engine.llvm.waiting import ALONE, IN_PLACE
from qrsim.engine.llvm.writing import Place

Move = tuple[Access, Shape, Place]


class InState:
    """Places nodes in the state.

    Args:
        body: the steps of a tick.
        stored: numbers of the nodes that need memory.
        short: numbers of those of which one element is in memory.
        places: of what has one; nodes that are placed are added.
        side_by_side: worlds lie side by side.
    """

    def __init__(
        self, body: list[Step], stored: set[int], short: set[int], places: dict[int, Place], side_by_side: bool
    ):
        self.body, self.stored, self.short = body, stored, short
        self.places, self.side_by_side = places, side_by_side
        self.read = readers(body)
        self.made = {node.number: i for i, step in enumerate(body) for node in step.nodes}
        # What lies where a leaf does, at one time or another: the leaf itself, and what takes its place.
        self.lying: dict[Place, list[Node]] = {}

    def place(self, leaves: Sequence[Node], results: Sequence[Access]) -> list[Move]:
        """Place results in the state's own memory where possible; return the copies that remain for the tick's end."""
        for access in results:
            self.read[access.node.number].append((len(self.body), None, access))
        self.lying = {self.places[leaf.number]: [leaf] for leaf in leaves}
        moves: list[Move] = []
        for leaf, access in zip(leaves, results, strict=True):
            node, place = access.node, self.places[leaf.number]
            if self._free(node) and access.identical(leaf.shape) and self._over(leaf, node):
                self._assign(node, place)
            elif not (node is leaf and access.identical(leaf.shape)):
                moves.append((access, leaf.shape, place))
        own = {leaf.number: leaf for leaf in leaves}
        for i, step in enumerate(self.body):
            if step.kind == "cond" and self._agreed(step):
                for output, results_of in _outputs(step):
                    self._hold(
                        i,
                        output,
                        [own[a.node.number] for a in results_of if a.node.number in own and a.identical(output.shape)],
                    )
        # The last one first, so that a chain of branchings, each of which changes what the one before left, lies there.
        for i, step in reversed(list(enumerate(self.body))):
            if step.kind == "cond" and self._agreed(step):
                for output, results_of in _outputs(step):
                    self._begin(i, output, results_of)
        for step in self.body:
            if step.kind == "cond" and self._agreed(step):
                self._within(step)
        return moves

    def _assign(self, node: Node, place: Place) -> None:
        """Assign a place in memory to a graph node."""
        self.places[node.number] = place
        self.lying[place].append(node)

    def _free(self, node: Node) -> bool:
        """Return whether a graph node is computed in the tick's body and has no fixed place in memory."""
        return node.number in self.made and self._is_movable(node)

    def _is_movable(self, node: Node) -> bool:
        """Return whether a graph node's result goes to memory and may be written to a place chosen for it."""
        stored = node.number in self.stored and node.number not in self.short
        fixed = node.op == "reduce" or (node.op in ALONE and node.op not in IN_PLACE)
        return stored and node.number not in self.places and not fixed

    def _agreed(self, step: Step) -> bool:
        """Return whether all worlds take the same branch of a conditional step."""
        # A branching that each world takes for itself writes its results before it has read everything.
        return not self.side_by_side or step.nodes[0].args[0].node.uniform

    def _fits(self, node: Node, place: Place) -> bool:
        """Return whether a place in memory has one element per world exactly if the node's value has."""
        return place.own == (self.side_by_side and not node.uniform)

    def _over(self, old: Node, writer: Node) -> bool:
        """Return whether all reads of the node ``old`` come before the node ``writer`` is written."""
        step = self.made[writer.number]
        return all(self._reads_first(self.body, reading, step, writer) for reading in self.read[old.number])

    def _reads_first(self, steps: list[Step], reading: Reading, step: int, writer: Node) -> bool:
        """Return whether a read comes before the store of the node ``writer``, which step number ``step`` computes."""
        at, reader, access = reading
        if at != step:
            return at < step
        if steps[step].kind == "while" and writer.op == "output":
            return _turns_into(steps[step], access.node, writer)
        if steps[step].kind != "cond":
            return reader is not None and steps[step].reads_before(reader, access, writer)
        return self._agreed(steps[step])

    def _hold(self, at: int, output: Node, leaves: list[Node]) -> None:
        """Place ``output`` of the conditional at step ``at`` in one of ``leaves`` that a branch returns unchanged."""
        for leaf in leaves:
            place = self.places[leaf.number]
            if not self._free(output) or not self._fits(output, place):
                return
            # What takes the leaf's place later must find nobody who still reads the result.
            later = [node for node in self.lying[place] if node is not leaf]
            if all(reading[0] <= at for reading in self.read[leaf.number]) and all(
                self.made[node.number] > at and self._over(output, node) for node in later
            ):
                self._assign(output, place)

    def _begin(self, at: int, output: Node, handed: list[Access]) -> None:
        """Place a node of ``handed``, which the conditional at step ``at`` returns unchanged, where ``output`` lies."""
        place = self.places.get(output.number)
        if place not in self.lying:
            return
        assert place is not None
        for access in handed:
            node = access.node
            if not access.identical(output.shape) or not self._free(node) or not self._fits(node, place):
                continue
            # Nobody reads it later, and nobody who reads what lies there at other times reads it while this does.
            others = [other for other in self.lying[place] if other is not output]
            if all(reading[0] <= at for reading in self.read[node.number]) and all(
                self._apart(other, node, at) for other in others
            ):
                self._assign(node, place)
                return

    def _apart(self, other: Node, node: Node, last: int) -> bool:
        """Return whether ``node``, read last by step ``last``, and ``other`` are never needed at the same time."""
        made = self.made.get(other.number, -1)
        return made > last or (made < self.made[node.number] and self._over(other, node))

    def _within(self, step: Step) -> None:
        """Make the branches of a conditional step write their results directly to the state's memory."""
        for number, steps in enumerate(step.branches):
            read, results = readers(steps), step.nodes[0].regions[number].results
            made = {node.number: i for i, inner in enumerate(steps) for node in inner.nodes}
            for output, _ in _outputs(step):
                access = results[output.attributes[0]]
                read[access.node.number].append((len(steps), None, access))
            for output, handed in _outputs(step):
                access, place = handed[number], self.places.get(output.number)
                node = access.node
                if place not in self.lying or node.number not in made or not self._is_movable(node):
                    continue
                assert place is not None
                if not self._fits(node, place) or not access.identical(output.shape):
                    continue
                at = made[node.number]
                # What lies there at other times is read before this node is written.
                if all(
                    self._reads_first(steps, reading, at, node)
                    for other in self.lying[place]
                    for reading in read.get(other.number, ())
                ):
                    self._assign(node, place)
            for inner in steps:
                if inner.kind == "cond" and self._agreed(inner):
                    self._within(inner)


def _turns_into(step: Step, old: Node, output: Node) -> bool:
    """Return whether a loop starts its output from the array ``old`` and reads that array nowhere else."""
    loop, place = step.nodes[0], output.attributes[0]
    begins = [access.node is old for access in loop.args]
    inside = [access for steps in step.branches for each in steps for _, access in each.accesses]
    return (
        begins[place]
        and begins.count(True) == 1
        and loop.args[place].identical(old.shape)
        and not any(access.node is old for access in (*inside, *branch_results(step)))
    )


def _outputs(step: Step) -> Iterator[tuple[Node, list[Access]]]:
    """Yield each result node of a conditional step, with its value in each branch."""
    regions = step.nodes[0].regions
    for node in step.nodes:
        if node.op == "output":
            yield node, [region.results[node.attributes[0]] for region in regions]
