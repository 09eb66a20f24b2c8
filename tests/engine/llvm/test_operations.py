"""Every operation of the code generator, against JAX on the same numbers, in each way of using vectors."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from qrsim.engine import llvm as code_generator
from qrsim.engine.layout import Packer
from qrsim.engine.llvm import Input, Mode, Program, UnsupportedError, build

SIZES = (1, 3, 8, 16, 21)
# In strips of 8 where the lanes are 8: longer arrays are cut.
MODES = (Mode(1, False), Mode(8, False, 8), Mode(16, False), Mode(16, True))
IDS = [f"{'worlds' if mode.side_by_side else 'elements'}{mode.lanes}" for mode in MODES]
# Lanes of 8 are written as those of 16, and compiled for machines that have no more.
every_mode = pytest.mark.parametrize(
    "mode", [pytest.param(mode, marks=pytest.mark.long if mode.lanes == 8 else (), id=name)
             for mode, name in zip(MODES, IDS, strict=True)]
)  # fmt: skip
# What fills a vector of 8, 16 does of 16.
every_size = pytest.mark.parametrize(
    "size", [pytest.param(size, marks=pytest.mark.long if size == 8 else ()) for size in SIZES]
)


def test_the_example_of_its_page_runs() -> None:
    """It ends with a check of its own."""
    page = Path(code_generator.__file__).with_name("README.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(example, {})


def run(function: Any, state: Any, mode: Mode, shared: Any = (), ticks: int = 1, first: int = 0) -> list[Any]:
    """Return the states of some worlds after some ticks, computed by a compiled program, and by JAX."""
    layouts = [Packer(shared), Packer(jax.tree.map(lambda leaf: leaf[0], state))]
    inputs = [Input(layouts[0], own=False), Input(layouts[1], own=True)]
    program = Program(build(function, inputs, mode), inputs, mode)
    worlds, found = len(jax.tree.leaves(state)[0]), []
    common = program.buffers(0)
    for mine, given in zip(common, layouts[0].pack(shared), strict=True):
        mine[...] = given
    for begin in range(0, worlds, mode.worlds):
        buffers = program.buffers(1)
        lanes = [min(begin + i, worlds - 1) for i in range(mode.worlds)]
        for lane, world in enumerate(lanes):
            packed = layouts[1].pack(jax.tree.map(lambda leaf, world=world: leaf[world], state))
            for mine, given in zip(buffers, packed, strict=True):
                mine.reshape(-1, mode.worlds)[:, lane] = given
        scratch = program.scratch()
        addresses = [part.ctypes.data for part in (*common, *buffers)]
        program(addresses, scratch.ctypes.data, first, ticks)
        for lane in range(min(mode.worlds, worlds - begin)):
            flat = tuple(np.array(part.reshape(-1, mode.worlds)[:, lane]) for part in buffers)
            found.append(layouts[1].unpack(flat))
    return found


_made: dict[Any, Any] = {}


def by_jax(function: Any, state: Any, shared: Any = (), ticks: int = 1, first: int = 0) -> list[Any]:
    """Return what JAX makes of each world; of the same function and numbers once, for all modes of a test."""
    cells = tuple(id(cell.cell_contents) for cell in function.__closure__ or ())
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves((state, shared))]
    given = tuple((leaf.shape, leaf.dtype, leaf.tobytes()) for leaf in leaves)
    key = (function.__code__, cells, given, jax.tree.structure((state, shared)), ticks, first)
    if key not in _made:
        # With the function, so that what it refers to keeps its id.
        _made[key] = function, _by_jax(function, state, shared, ticks, first)
    return _made[key][1]


def _by_jax(function: Any, state: Any, shared: Any, ticks: int, first: int) -> list[Any]:
    stepped = jax.jit(lambda one, tick: function(shared, one, tick))
    found = []
    for world in range(len(jax.tree.leaves(state)[0])):
        one = jax.tree.map(lambda leaf, world=world: leaf[world], state)
        for tick in range(first, first + ticks):
            one = stepped(one, jnp.int32(tick))
        found.append(jax.tree.map(np.asarray, one))
    return found


def check(function: Any, state: Any, mode: Mode, rtol: float = 3e-6, atol: float = 1e-6, **more: Any) -> None:
    """Compare both."""
    for mine, theirs in zip(run(function, state, mode, **more), by_jax(function, state, **more), strict=True):
        for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(theirs), strict=True):
            assert a.shape == b.shape
            assert a.dtype == b.dtype
            np.testing.assert_allclose(a, b, rtol=rtol, atol=atol)


def numbers(size: int, seed: int = 0, worlds: int = 18, scale: float = 3.0) -> np.ndarray[Any, Any]:
    """Return numbers of both signs (worlds, size), among them zero, NaN and infinity."""
    values = np.random.default_rng(seed).normal(0.0, scale, (worlds, size)).astype(np.float32)
    values.ravel()[::7] = 0.0
    values.ravel()[3::11] = np.nan
    values.ravel()[5::13] = np.inf
    return values


FLOATS = {
    "sum": lambda x, y: x + y - 2.0 * y,
    "product": lambda x, y: x * y + x,
    "quotient": lambda x, y: x / (1.0 + y * y),
    "extremes": lambda x, y: jnp.minimum(x, y) + jnp.maximum(x, 0.5) + jnp.clip(y, -1.0, 1.0),
    "clamp": lambda x, y: lax.clamp(jnp.full_like(x, -1.0), x, jnp.abs(y)),
    "choice": lambda x, y: jnp.where(x > y, x, -y),
    "sign": lambda x, y: jnp.sign(x) * jnp.abs(y),
    "rounding": lambda x, y: jnp.round(x) + jnp.floor(y) + jnp.ceil(x),
    "roots": lambda x, y: jnp.sqrt(jnp.abs(x)) + lax.rsqrt(1.0 + y * y),
    "powers": lambda x, y: x**3 + (1.0 + jnp.abs(y)) ** -2 + jnp.square(x),
    "remainder": lambda x, y: lax.rem(x, 1.0 + jnp.abs(y)),
    "finite": lambda x, y: jnp.where(jnp.isfinite(x) & ~jnp.isnan(y), x, 7.0),
    "logic": lambda x, y: jnp.where((x > 0.0) ^ (y > 0.0) | (x == y) & (x != 1.0), 1.0, 0.0),
    "exponentials": lambda x, y: jnp.exp(-jnp.abs(x)) + jnp.expm1(-jnp.abs(y)) + jnp.log1p(jnp.abs(x)),
    "angles": lambda x, y: jnp.sin(x) + jnp.cos(y) + jnp.arctan2(x, y) + jnp.tanh(x),
}


@pytest.mark.filterwarnings("ignore:invalid value")
@every_mode
class TestElementwise:
    @pytest.mark.parametrize("name", FLOATS)
    def test_floats(self, name, mode):
        """NaN and infinity go the same way too; sizes that do and do not fill a vector."""
        rule = FLOATS[name]

        def function(_, state, tick):
            return [(rule(x, y), y) for x, y in state]

        finite = name in ("angles", "remainder")
        state = [(numbers(size, size), numbers(size, size + 50)) for size in SIZES]
        state = jax.tree.map(lambda leaf: np.nan_to_num(leaf, posinf=2.0) if finite else leaf, state)
        check(function, state, mode)

    def test_integers(self, mode):
        def function(_, state, tick):
            a, b, u = state["a"], state["b"], state["u"]
            return {
                "a": (a * 3 - b) % 7
                + lax.div(a, 2)
                + jnp.abs(b)
                + jnp.sign(a)
                + lax.shift_right_arithmetic(b, 2)
                + tick,
                "b": jnp.minimum(a, b) ^ jnp.maximum(a, 5) | (b & ~a),
                "u": ((u << jnp.uint32(7)) | (u >> jnp.uint32(25))) + u // jnp.uint32(3),
                "f": a.astype(jnp.float32) + u.astype(jnp.float32) * 1e-3 + (a > b).astype(jnp.float32),
                "i": (state["f"] * 10.0).astype(jnp.int32) + lax.bitcast_convert_type(state["f"], jnp.int32),
                "flag": (u > jnp.uint32(2**31)) | (a < b),
            }

        random = np.random.default_rng(1)
        for size in SIZES:
            state = {
                "a": random.integers(-99, 99, (18, size), np.int32),
                "b": random.integers(-99, 99, (18, size), np.int32),
                "u": random.integers(0, 2**32, (18, size), np.uint32),
                "f": random.normal(0.0, 5.0, (18, size)).astype(np.float32),
                "i": np.zeros((18, size), np.int32),
                "flag": np.zeros((18, size), bool),
            }
            check(function, state, mode, ticks=3, first=5)


@every_mode
class TestArrays:
    @every_size
    def test_axes_parts_and_reductions(self, size, mode):
        """Views, joining, sums and extremes along either axis, arrays of no element, and places of extremes."""

        def function(shared, state, tick):
            x, wide = state["x"], state["wide"]
            pairs = x[:, None] - x[None, :]
            grid = jnp.stack([x, 2.0 * x, wide[1]]) + shared["offset"][:, None]
            joined = jnp.concatenate([x, x[:1], -x])
            return {
                "x": jnp.min(jnp.where(jnp.eye(size, dtype=bool), jnp.inf, jnp.abs(pairs)), axis=1, initial=9.0),
                "wide": grid + jnp.sum(grid, axis=0)[None] - joined[None, 1 : size + 1] + wide.T.T,
                "all": jnp.sum(grid) + jnp.max(wide) * jnp.min(pairs) + jnp.sum(wide, axis=1)[2],
                "any": jnp.any(grid > 1.0, axis=0) & jnp.all(wide < 5.0, axis=0),
                "where": jnp.argmin(grid, axis=0) + jnp.argmax(wide, axis=1)[0] + jnp.arange(size, dtype=jnp.int32),
                "none": jnp.min(jnp.zeros((0, size)) + x[None], axis=0, initial=4.0),
            }

        state = {
            "x": np.nan_to_num(numbers(size, 1), posinf=1.0),
            "wide": np.nan_to_num(numbers(3 * size, 2), posinf=1.0).reshape(18, 3, size),
            "all": np.zeros(18, np.float32),
            "any": np.zeros((18, size), bool),
            "where": np.zeros((18, size), np.int32),
            "none": np.zeros((18, size), np.float32),
        }
        check(function, state, mode, shared={"offset": np.array([1.0, -2.0, 0.5], np.float32)}, rtol=1e-5, atol=1e-4)

    def test_a_part_that_begins_where_the_program_says(self, mode):
        """Starts beyond the array are brought into it, as JAX does."""

        def function(shared, state, tick):
            table, place = shared["table"], state["place"]
            row = lax.dynamic_slice(table, (place, jnp.int32(0)), (1, 5))[0]
            own = lax.dynamic_slice(state["x"], (place + tick,), (4,))
            same = lax.dynamic_index_in_dim(table, tick, 0, keepdims=False)
            return {"place": place + 1, "x": state["x"] + row[0] + jnp.sum(own) * 1e-2, "row": row + same}

        state = {
            "place": np.arange(-4, 14, dtype=np.int32),
            "x": np.random.default_rng(3).normal(size=(18, 9)).astype(np.float32),
            "row": np.zeros((18, 5), np.float32),
        }
        table = np.random.default_rng(4).normal(size=(6, 5)).astype(np.float32)
        check(function, state, mode, shared={"table": table}, ticks=4)

    @pytest.mark.parametrize("size", SIZES[1:])
    def test_elements_from_where_the_program_says(self, size, mode):
        """Out of range there is a number in their place, or the nearest; from a shared array and from each its own."""

        def function(shared, state, tick):
            table, place, x = jnp.asarray(shared["table"]), state["place"] + tick, state["x"]
            pairs = jnp.stack([x, -x, 2.0 * x], axis=1)
            along = jnp.abs(place) % 3
            return {
                "place": place,
                "x": table.at[place, 1].get(mode="fill", fill_value=-7.0),
                "near": x.at[place].get(mode="clip") + jnp.take_along_axis(pairs, along[:, None], axis=1)[:, 0],
                "whole": jnp.where(jnp.isnan(x[place]), 5.0, x[0]),
                "flag": (x > 0.0).at[place].get(mode="clip"),
            }

        random = np.random.default_rng(8)
        state = {
            "place": random.integers(-size - 4, size + 4, (18, size), np.int32),
            "x": random.normal(size=(18, size)).astype(np.float32),
            "near": np.zeros((18, size), np.float32),
            "whole": np.zeros((18, size), np.float32),
            "flag": np.zeros((18, size), bool),
        }
        table = random.normal(size=(6, 3)).astype(np.float32)
        check(function, state, mode, shared={"table": table}, ticks=3)

    def test_numbers_put_where_the_program_says(self, mode):
        """In their order; what is out of range is left out."""

        def function(_, state, tick):
            place, x = state["place"] + tick, state["x"]
            table = jnp.full((4, 5), 2.0).at[place, 1].min(x, mode="drop").at[jnp.array([2, 3]), place[:2]].set(x[:2])
            rows = jnp.stack([x, 2.0 * x]).at[jnp.arange(2), place[1:3]].add(x[:2], mode="drop")
            seen = jnp.zeros((1, 9), bool).at[0, place].max(x > 0.0, mode="drop")
            return {"place": place, "x": jnp.tanh(rows[0] + rows[1]), "table": table, "seen": seen}

        random = np.random.default_rng(11)
        state = {
            "place": random.integers(-5, 9, (18, 9), np.int32),
            "x": random.normal(size=(18, 9)).astype(np.float32),
            "table": np.zeros((18, 4, 5), np.float32),
            "seen": np.zeros((18, 1, 9), bool),
        }
        check(function, state, mode, ticks=4)

    def test_other_shapes_of_the_same_numbers(self, mode):
        def function(_, state, tick):
            x = state * 2.0
            return (x.reshape(6, 7, 2).T.reshape(84) + x.reshape(4, 21).T.ravel()) * 0.5

        state = np.random.default_rng(9).normal(size=(18, 84)).astype(np.float32)
        check(function, state, mode, ticks=3)

    @every_size
    def test_each_world_takes_a_branch_of_its_own(self, size, mode):
        """Some take one, some the other, all or none; what they hold is kept, and may be swapped."""

        def function(_, state, tick):
            def due():
                return dict(state, x=2.0 * state["y"] + jnp.sum(state["x"]), y=state["x"])

            after = lax.cond((state["phase"] + tick) % 4 == 0, due, lambda: dict(state, y=state["y"] + 1.0))
            often = lax.cond(after["phase"] >= 0, lambda: after["x"] * 0.5, lambda: after["y"])
            return {"phase": state["phase"], "x": often + lax.cond(tick > 2, lambda: after["y"], lambda: after["x"]),
                    "y": lax.cond(state["phase"] < 0, lambda: often, lambda: after["y"])}  # fmt: skip

        random = np.random.default_rng(10)
        state = {
            "phase": np.arange(18, dtype=np.int32) % 4,
            "x": random.normal(size=(18, size)).astype(np.float32),
            "y": random.normal(size=(18, size)).astype(np.float32),
        }
        check(function, state, mode, ticks=5, rtol=1e-5)

    @every_size
    def test_each_world_goes_round_as_often_as_it_needs(self, size, mode):
        """Not once, or many times; two arrays swap at every turn, within are branches and another such loop."""

        def function(_, state, tick):
            def turn(now):
                left, x, y, total = now
                y = lax.cond(left % 3 == 0, lambda: y * 0.5, lambda: y + 1.0)
                total = total + lax.fori_loop(
                    0, left % 4, lambda i, sum_: sum_ + jnp.sum(x) * (i + 1), jnp.float32(0.0)
                )
                return left - 1, y, x * 0.9, total

            carry = (state["left"], state["x"], state["y"], jnp.float32(0.0))
            left, x, y, total = lax.while_loop(lambda now: now[0] > 0, turn, carry)
            return {"left": state["left"] + left, "x": x, "y": y + state["y"] * 1e-3, "total": state["total"] + total}

        random = np.random.default_rng(12)
        state = {
            "left": np.arange(18, dtype=np.int32) % 7,
            "x": random.normal(size=(18, size)).astype(np.float32),
            "y": random.normal(size=(18, size)).astype(np.float32),
            "total": np.zeros(18, np.float32),
        }
        check(function, state, mode, ticks=3, rtol=2e-5, atol=1e-4)

    @pytest.mark.parametrize("keeps", ["nothing", "the array before", "sums of both"])
    def test_changes_in_a_loop_stay_in_worlds_that_still_turn(self, keeps, mode):
        """Cells are changed one at a turn, each world as often as it needs, whether or not the old ones are wanted."""

        def function(_, state, tick):
            def turn(now):
                left, cells, before, total = now
                at = (left * 7) % 24
                total = total + cells[at]
                after = cells.at[at].set(0.5 * cells[at] + left.astype(jnp.float32))
                if keeps == "sums of both":
                    total = total + jnp.sum(after) - 0.5 * jnp.sum(cells)
                return left - 1, after, cells if keeps == "the array before" else before, total

            carry = (state["left"], state["cells"], state["before"], state["total"])
            left, cells, before, total = lax.while_loop(lambda now: now[0] > 0, turn, carry)
            return {"left": state["left"] + left, "cells": cells, "before": before, "total": total}

        random = np.random.default_rng(15)
        state = {
            "left": np.arange(18, dtype=np.int32) % 7,
            "cells": random.normal(size=(18, 24)).astype(np.float32),
            "before": np.zeros((18, 24), np.float32),
            "total": np.zeros(18, np.float32),
        }
        check(function, state, mode, ticks=3, rtol=2e-5, atol=1e-3)

    def test_running_sums(self, mode):
        def function(_, state, tick):
            return jnp.cumsum(state, axis=0) - lax.cumsum(state, axis=1, reverse=True) * 0.5

        state = np.random.default_rng(13).normal(size=(18, 5, 21)).astype(np.float32)
        check(function, state, mode, ticks=2, rtol=1e-5, atol=1e-4)

    def test_only_every_third_tick(self, mode):
        """Branches that all worlds take together; the states that they hold, shift and swap."""

        def function(_, state, tick):
            def due():
                return {
                    "x": state["x"] * 1.5 + jnp.sum(state["queue"][0]),
                    "queue": (state["queue"][1], state["queue"][2], state["x"] + 1.0),
                    "swap": state["swap"][::1] - 1.0,
                }

            after = lax.cond(tick % 3 == 0, due, lambda: dict(state, swap=state["swap"] + state["x"]))
            return dict(after, queue=(after["queue"][0], after["queue"][2], after["queue"][1]))

        for size in SIZES:
            parts = [np.nan_to_num(numbers(size, i), posinf=1.0) for i in range(5)]
            state = {"x": parts[0], "queue": tuple(parts[1:4]), "swap": parts[4]}
            check(function, state, mode, ticks=8, rtol=1e-5)


def test_both_ways_and_every_width_give_the_same_to_the_bit():
    """Products and sums are rounded by one rule, and sums run in one order."""

    def function(shared, state, tick):
        x, y = state
        grid = (x[:, None] * y[None, :] + shared) * jnp.float32(0.37)
        return jnp.sum(grid * grid, axis=0) - x * y, y * 0.9 + jnp.sum(grid, axis=1) * 1e-3

    random = np.random.default_rng(5)
    state = tuple(random.normal(size=(18, 13)).astype(np.float32) for _ in range(2))
    shared = np.float32(0.1)
    runs = [run(function, state, mode, shared=shared, ticks=5) for mode in MODES]
    for other in runs[1:]:
        for mine, theirs in zip(runs[0], other, strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_double_precision():
    with jax.enable_x64(True):

        def function(shared, state, tick):
            return jnp.sin(state) * shared + jnp.exp(-state * state) * tick.astype(float)

        state = np.random.default_rng(6).normal(size=(9, 11))
        for mode in (Mode(1, False), Mode(8, False), Mode(8, True)):
            check(function, state, mode, shared=np.float64(0.3), ticks=3, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    ("what", "function"),
    [
        ("sort", lambda _, state, tick: jnp.sort(state)),
        ("a gather of parts", lambda _, state, tick: state.reshape(2, 3)[state.astype(int) % 2].sum() + state),
        ("a scatter of parts", lambda _, state, tick: state.reshape(2, 3).at[tick].set(1.0).ravel()),
    ],
)
def test_what_it_cannot_do_is_said(what, function):
    """With the name of the operation."""
    state = np.arange(18 * 6, dtype=np.float32).reshape(18, 6)
    with pytest.raises(UnsupportedError, match=what):
        run(function, state, Mode(16, True))
