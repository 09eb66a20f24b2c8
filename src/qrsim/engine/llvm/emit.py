"""From steps to LLVM's text: one function that advances some worlds by any number of ticks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from qrsim.engine.llvm import kernels
from qrsim.engine.llvm.graph import Node
from qrsim.engine.llvm.halves import HALVES, write_half
from qrsim.engine.llvm.loops import Loops, shared_axis
from qrsim.engine.llvm.neighbours import Neighbours
from qrsim.engine.llvm.refusal import UnsupportedError
from qrsim.engine.llvm.scattering import write_scatter, write_update
from qrsim.engine.llvm.schedule import Step
from qrsim.engine.llvm.text import neutral, scalar_type, splat, stored_type, vector
from qrsim.engine.llvm.turns import parts_of, turns_of
from qrsim.engine.llvm.writing import Place, Scope


class Emitter(Loops):
    """Writes the text of steps; the arguments are those of ``Loops``."""

    # Steps

    def steps(self, steps: list[Step], stored: set[int]) -> None:
        """Emit LLVM code for the steps of a schedule; ``stored`` has the numbers of the nodes kept in memory."""
        for step in steps:
            if step.kind == "cond":
                self._branching(step, stored)
            elif step.kind == "while":
                self._repeating(step, stored)
            elif step.kind == "running":
                self._running(step.nodes[0])
            elif step.kind == "concatenate":
                self._concatenation(step.nodes[0])
            elif step.kind == "nearest":
                Neighbours(self).write(step.nodes[0])
            elif step.kind in HALVES:
                write_half(self, step.nodes[0])
            elif step.kind in ("scatter", "update"):
                (write_scatter if step.kind == "scatter" else write_update)(self, step.nodes[0])
            elif step.kind == "rows":
                self._rows(step, stored)
            # Scalars stay in registers, between loops too.
            elif step.domain == ():
                self._straight(step)
            elif 0 not in step.domain or any(node.op == "reduce" for node in step.nodes):
                self._nest(step, stored)

    def _compute(self, node: Node, lanes: int) -> str:
        """Emit LLVM code that computes ``lanes`` elements of a graph node, and return the name of its value."""
        if node.op == "iota":
            return self._iota(node, lanes)
        if node.op == "pick":
            return self._pick(node, lanes)
        values = [self.widened(self.value(access), access.node.dtype, lanes) for access in node.args]
        return self.operations.compute(node, values, lanes)

    def _kernel(self, node: Node, scopes: list[Scope], lanes: int) -> list[str]:
        """Emit a call of an elementwise kernel; return one result per scope, and keep its other results."""
        name, place = node.attributes
        keys = []
        for scope in scopes:
            self.scope = scope
            values = [self.widened(self.value(access), access.node.dtype, lanes) for access in node.args]
            keys.append((name, lanes, *values))
        if keys[-1] not in scopes[-1].offsets:
            turns = [list(key[2:]) for key in keys]
            if self.kernels_inside:
                found = kernels.body(name).write(self.operations, turns, lanes)
            else:
                self.kernels.add((name, lanes))
                found = [kernels.call(self.emit, name, turn, lanes) for turn in turns]
            for scope, key, results in zip(scopes, keys, found, strict=True):
                scope.offsets[key] = results
        return [scope.offsets[key][place] for scope, key in zip(scopes, keys, strict=True)]

    def _straight(self, step: Step) -> None:
        """Emit a step of scalar graph nodes, outside any loop, and note the names of their values."""
        self.scope = Scope((), [], None, {}, {})
        for node in step.nodes:
            lanes = self._lanes_of(node)
            value = self._kernel(node, [self.scope], lanes)[0] if node.op == "kernel" else self._compute(node, lanes)
            self.scalars[node.number] = value, lanes

    def _iota(self, node: Node, lanes: int) -> str:
        """Emit the values of an iota (each element's index along an axis) from the loop counter; return them."""
        axis = node.attributes[0]
        element, counter = scalar_type(node.dtype), self.scope.variables[axis]
        if node.dtype.kind not in "iu":
            raise UnsupportedError("an iota of floating-point numbers")
        # Counters are i64, as addresses are.
        number = self.emit(f"trunc i64 {counter} to {element}") if element != "i64" else counter
        if axis != self.scope.lane_axis:
            return self.widened((number, 1), node.dtype, lanes)
        of = vector(element, lanes)
        ramp = "<" + ", ".join(f"{element} {lane}" for lane in range(lanes)) + ">"
        return self.emit(f"add {of} {self.widened((number, 1), node.dtype, lanes)}, {ramp}")

    def _nest(self, step: Step, stored: set[int]) -> None:
        """Emit loops over the axes that a step keeps, in them over those it reduces (``stored``: nodes in memory)."""
        if any(step.domain[axis] == 0 for axis in step.kept):
            return
        last = len(step.domain) - 1
        ordered = any(node.op == "reduce" and node.attributes[0] in ("add", "mul") for node in step.nodes)
        lane_axis: int | None = last
        # A sum along the vector's own axis would be taken in another order.
        if self.side_by_side or self.lanes == 1 or (last in step.reduced and ordered):
            lane_axis = None
        together = 1 if step.reduced else turns_of(step, shared_axis(step.kept, lane_axis))
        self._loops(step, step.kept, Scope(step.domain, ["0"] * (last + 1), lane_axis, {}, {}), together, stored)

    def _rows(self, step: Step, stored: set[int]) -> None:
        """Emit one loop over the last axis with several loop nests in its body (``stored``: nodes in memory)."""
        vectors = self.lanes > 1 and not self.side_by_side
        # Numbers of which an element of the axis has one stay in registers for the parts that follow.
        row: dict[int, str] = {}
        self.open_scope(step.domain)
        # A few vectors in a row are close to each other.
        self.far = vectors and step.domain[0] > 4 * self.lanes
        with self.along(step.domain[0], self.lanes if vectors else 1) as counter:
            for part in step.parts:
                last = len(part.domain) - 1
                kept = [axis for axis in part.kept if axis != last]
                together = turns_of(part, shared_axis(part.reduced or kept, None))
                scope = Scope(part.domain, ["0"] * last + [counter], last if vectors else None, {}, {}, row)
                accumulators = self._loops(part, kept, scope, together, stored)
                if not kept:
                    row |= {n: self.load(node.dtype, pointer, self._reduced_width(node))
                            for n, (node, pointer) in accumulators.items()}  # fmt: skip
                if last == 0:
                    row |= scope.values
        self.far = False

    def _loops(
        self, step: Step, kept: Sequence[int], scope: Scope, together: int, stored: set[int]
    ) -> dict[int, tuple[Node, str]]:
        """Emit loops over axes ``kept`` and reduced ones, unrolled by ``together``; return reductions, accumulators.

        Several turns of the innermost may be written at once, each with values of its own: divisions and roots of one
        wait while those of the other run.
        """
        scopes = [scope, *(replace(scope, variables=[], values={}, offsets={}) for _ in range(1, together))]
        self.scope, lane_axis = scope, scope.lane_axis
        with self.over(kept, step.domain, lane_axis, 1 if step.reduced else together):
            # On the stack, which LLVM turns into registers: then nothing need be carried through the loops by hand.
            reductions = [node for node in step.nodes if node.op == "reduce"]
            accumulators = {node.number: (node, self._accumulator(node)) for node in reductions}
            with self.over(step.reduced, step.domain, lane_axis, together):
                self._spread_counters(scopes, shared_axis(step.reduced or kept, lane_axis))
                if 0 not in step.domain:
                    self._body(step, scopes, accumulators, stored)
            for node, pointer in accumulators.values():
                if node.number in stored:
                    self._finish(node, pointer)
        return accumulators

    def _spread_counters(self, scopes: list[Scope], axis: int | None) -> None:
        """Offset the loop counters of ``scopes``, the further copies of an unrolled loop body, along an axis."""
        for i, scope in enumerate(scopes[1:], 1):
            scope.variables[:] = scopes[0].variables
            assert axis is not None
            counter = scopes[0].variables[axis]
            scope.variables[axis] = self.emit(f"add nuw nsw i64 {counter}, {i}")
            scope.offsets.clear()

    def _body(
        self, step: Step, scopes: list[Scope], accumulators: dict[int, tuple[Node, str]], stored: set[int]
    ) -> None:
        """Emit the body of a loop, its unrolled copies (``scopes``) interleaved (``stored``: nodes in memory)."""
        several = len(scopes) > 1 and bool(accumulators)
        # LLVM would begin all sums of all turns first, and move most of them to memory.
        self.topdown |= several
        for part in parts_of(step.nodes) if several else [[node] for node in step.nodes]:
            if part[0].op == "kernel":
                for scope, value in zip(scopes, self._kernel(part[0], scopes, self._width(part[0])), strict=True):
                    scope.values[part[0].number] = value
                continue
            for scope in scopes:
                self.scope = scope
                for node in part:
                    if node.op == "reduce":
                        self._accumulate(*accumulators[node.number])
                    else:
                        scope.values[node.number] = self._compute(node, self._width(node))
        for scope in scopes:
            self.scope = scope
            self._keep(step, stored)
        self.scope = scopes[0]

    def _keep(self, step: Step, stored: set[int]) -> None:
        """Emit the stores of a loop body's results after all its loads (``stored``: nodes kept in memory)."""
        for node in step.nodes:
            if node.number in stored and node.op != "reduce":
                value = self.scope.values[node.number]
                self.write(self.places[node.number], node.dtype, value, self._width(node), self.scope.variables)

    # Reductions

    def _reduced_width(self, node: Node) -> int:
        """Return the number of lanes of the accumulator of a reduction node."""
        operand = node.args[0].node
        if self.side_by_side:
            return self._lanes_of(operand) if operand.op != "constant" else 1
        return 1 if self.scope.lane_axis is None else self.lanes

    def _accumulator(self, node: Node) -> str:
        """Emit the allocation and initial value of a reduction's accumulator, and return its pointer."""
        lanes, pointer = self._reduced_width(node), self.name("sum")
        of = vector(stored_type(node.dtype), lanes)
        self.entry.append(f"  {pointer} = alloca {of}, align 64")
        self.store(
            node.dtype, pointer, splat(neutral(node.attributes[0], node.dtype), scalar_type(node.dtype), lanes), lanes
        )
        return pointer

    def _accumulate(self, node: Node, pointer: str) -> None:
        """Emit one step of a reduction: combine the node's present value with the accumulator at ``pointer``."""
        lanes = self._reduced_width(node)
        access = node.args[0]
        value = self.widened(self.value(access), node.dtype, lanes)
        axis = self.scope.lane_axis
        # The last vector reaches beyond the end, and what lies there must not be counted.
        if axis is not None and axis in node.attributes[1] and self.scope.domain[axis] % lanes:
            inside = self.inside(self.scope.variables[axis], self.scope.domain[axis])
            of = vector(scalar_type(node.dtype), lanes)
            none = splat(neutral(node.attributes[0], node.dtype), scalar_type(node.dtype), lanes)
            value = self.emit(f"select {vector('i1', lanes)} {inside}, {of} {value}, {of} {none}")
        before = self.load(node.dtype, pointer, lanes)
        self.store(
            node.dtype, pointer, self.operations.combine(node.attributes[0], node.dtype, lanes, before, value), lanes
        )

    def _finish(self, node: Node, pointer: str) -> None:
        """Emit the result of a reduction from its accumulator; lanes are combined if they lie along a reduced axis."""
        lanes, axis = self._reduced_width(node), self.scope.lane_axis
        value = self.load(node.dtype, pointer, lanes)
        if axis is not None and axis in node.attributes[1]:
            of = vector(scalar_type(node.dtype), lanes)
            parts = [self.emit(f"extractelement {of} {value}, i32 {lane}") for lane in range(lanes)]
            value, lanes = parts[0], 1
            for part in parts[1:]:
                value = self.operations.combine(node.attributes[0], node.dtype, 1, value, part)
        kept = [v for a, v in enumerate(self.scope.variables) if a not in node.attributes[1]]
        place = self.places[node.number]
        wanted = self.lanes if place.own and self.side_by_side else lanes
        address = self.address(place, [(v, 0) for v in kept])
        self.store(node.dtype, address, self.widened((value, lanes), node.dtype, wanted), wanted)

    # Moves

    def _concatenation(self, node: Node) -> None:
        """Emit a concatenation: copies of the joined arrays to their parts of the result."""
        axis, begins, shapes = node.attributes
        place = self.places[node.number]
        for access, begin, shape in zip(node.args, begins, shapes, strict=False):
            # A part of one element has no axis here; the others have all of the whole's.
            whole = len(shape) == len(node.shape)
            moved = Place(
                place.pointer, place.offset + begin * place.strides[axis],
                place.strides if whole else tuple(s for a, s in enumerate(place.strides) if a != axis),
                place.own, tight=0 < axis == len(node.shape) - 1,
            )  # fmt: skip
            # Parts are written in order, so that what is written behind one is overwritten by the next; but what is
            # written behind the last one of a row, where parts are pieces of rows, may be the beginning of another.
            self.copy(access, shape, moved)

    def _running(self, node: Node) -> None:
        """Emit a cumulative operation along an axis, such as a cumulative sum."""
        axis, backwards, how = node.attributes
        self.open_scope(node.shape)
        lanes, (last, dtype) = self._lanes_of(node), (node.shape[axis] - 1, node.dtype)
        pointer, of = self.name("sum"), vector(stored_type(dtype), lanes)
        self.entry.append(f"  {pointer} = alloca {of}, align 64")
        with self.over([i for i in range(len(node.shape)) if i != axis], node.shape, None):
            self.store(dtype, pointer, splat(neutral(how, dtype), scalar_type(dtype), lanes), lanes)
            with self.loop(last + 1) as counter:
                along = self.emit(f"sub i64 {last}, {counter}") if backwards else counter
                self.scope.variables[axis] = along
                value = self.widened(self.value(node.args[0]), dtype, lanes)
                total = self.operations.combine(how, dtype, lanes, self.load(dtype, pointer, lanes), value)
                self.store(dtype, pointer, total, lanes)
                self.write(self.places[node.number], dtype, total, lanes, self.scope.variables)

    # Branches and repetition

    def _repeating(self, step: Step, stored: set[int]) -> None:
        """Emit a while loop that each world leaves when its condition is false (``stored``: nodes in memory)."""
        node = step.nodes[0]
        condition, body = node.regions
        places = [self.places[output.number] for output in node.attributes[1]]
        self.move_all([(a, c.shape, p) for a, c, p in zip(node.args, node.attributes[0], places, strict=True)])
        # A value that is computed inside is not known outside: its block need not have run.
        outside = dict(self.scalars)
        self.count += 1
        label = f"while{self.count}"
        self.do(f"br label %{label}")
        self.start_block(label)
        self.steps(step.branches[0], stored)
        self.scope = Scope((), [], None, {}, {})
        goes_on, lanes = self.value(condition.results[0])
        keep, outer = None, self.turning
        if lanes > 1:
            if outer is not None:
                # A world that is not here at all must not keep the others turning.
                goes_on = self.emit(f"and {vector('i1', lanes)} {goes_on}, {outer}")
            self.turning = goes_on
            mask, every = vector("i1", lanes), splat("true", "i1", lanes)
            keep = self.emit(f"xor {mask} {goes_on}, {every}")
            goes_on = self._any(goes_on)
        self.do(f"br i1 {goes_on}, label %{label}.body, label %{label}.after")
        self.start_block(f"{label}.body")
        self.steps(step.branches[1], stored)
        self.move_all([(a, c.shape, p) for a, c, p in zip(body.results, node.attributes[0], places, strict=True)], keep)
        self.do(f"br label %{label}")
        self.start_block(f"{label}.after")
        self.scalars, self.turning = outside, outer

    def _any(self, flags: str) -> str:
        """Emit the OR of each world's flag, and return the name of the scalar flag."""
        mask, name = vector("i1", self.lanes), f"llvm.vector.reduce.or.v{self.lanes}i1"
        self.declarations.add(f"declare i1 @{name}({mask})")
        return self.emit(f"call i1 @{name}({mask} {flags})")

    def _branching(self, step: Step, stored: set[int]) -> None:
        """Emit a conditional of two branches: one for all worlds, or one for each by a mask (``stored``: in memory)."""
        cond = step.nodes[0]
        self.scope = Scope((), [], None, {}, {})
        which, lanes = self.value(cond.args[0])
        dtype = cond.args[0].node.dtype
        of, zero = vector(scalar_type(dtype), lanes), splat("0", scalar_type(dtype), lanes)
        # What is below the number of the first branch takes the first.
        above = f"icmp {'s' if dtype.kind == 'i' else 'u'}gt {of} {which}, {zero}"
        taken = which if dtype.kind == "b" else self.emit(above)
        self.count += 1
        label = f"branch{self.count}"
        if lanes > 1:
            self._branch_by_world(step, taken, label, stored)
            return
        # All worlds agree, so one branch really is skipped: that is what makes slow sensors cheap.
        self.do(f"br i1 {taken}, label %{label}.true, label %{label}.false")
        for number in (0, 1):
            self._branch(step, number, f"{label}.{'true' if number else 'false'}", f"{label}.after", stored)
        self.start_block(f"{label}.after")

    def _branch_by_world(self, step: Step, taken: str, label: str, stored: set[int]) -> None:
        """Emit a conditional by world: each branch is run, with a mask, if any world takes it (``taken``: flags)."""
        mask = vector("i1", self.lanes)
        # A branch that no world takes is still skipped.
        others = self.emit(f"xor {mask} {taken}, {splat('true', 'i1', self.lanes)}")
        outer, masks = self.turning, [taken, others]
        if outer is not None:
            masks = [self.emit(f"and {mask} {own}, {outer}") for own in masks]
        self.do(f"br i1 {self._any(taken)}, label %{label}.true, label %{label}.rest")
        self.turning = masks[0]
        self._branch(step, 1, f"{label}.true", f"{label}.rest", stored)
        self.start_block(f"{label}.rest")
        self.do(f"br i1 {self._any(others)}, label %{label}.false, label %{label}.after")
        self.turning = masks[1]
        self._branch(step, 0, f"{label}.false", f"{label}.after", stored, keep=taken)
        self.turning = outer
        self.start_block(f"{label}.after")

    def _branch(
        self, step: Step, number: int, label: str, after: str, stored: set[int], keep: str | None = None
    ) -> None:
        """Emit branch ``number``, then a jump to ``after``; worlds in the mask ``keep`` keep their old results."""
        outside = dict(self.scalars)
        self.start_block(label)
        self.steps(step.branches[number], stored)
        region, outputs = step.nodes[0].regions[number], step.nodes[1:]
        moves = [
            (region.results[node.attributes[0]], node.shape, self.places[node.number])
            for node in outputs
            if node.op == "output"
        ]
        self.move_all(moves, keep)
        self.do(f"br label %{after}")
        self.scalars = outside
