"""What is computed where the state lies: what a branching hands out of it unchanged, and what branches make for it."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from tests.engine.llvm.test_operations import IDS, MODES, check

from qrsim.engine.layout import Packer
from qrsim.engine.llvm import Input, Mode, build
from qrsim.engine.llvm.loops import Loops

LEAVES = 4


def branching(seed: int) -> Callable[..., Any]:
    """Return a function of a state of leaves (3, n) that hands them on, mixes them, and branches by the tick."""

    def mixed(choose: random.Random, known: list[Any]) -> Any:
        x, y = choose.choice(known), choose.choice(known)
        kind = choose.randrange(5)
        if kind == 0:
            return x
        if kind == 1:
            return 0.5 * x - jnp.roll(y, 1, axis=0)
        if kind == 2:
            return jnp.maximum(x, jnp.roll(y, 1, axis=1)) * 0.75
        if kind == 3:
            return 0.25 * x + jnp.sum(y, axis=0)[None]
        return jnp.minimum(x, 0.5 - y)

    def branched(choose: random.Random, known: list[Any], tick: Any, depth: int) -> list[Any]:
        count, every, kept = choose.randint(1, LEAVES), choose.choice((2, 3)), choose.random()
        held = [choose.choice(known[:LEAVES]) for _ in range(count)]

        def branch(number: int) -> Callable[[], tuple[Any, ...]]:
            def of() -> tuple[Any, ...]:
                mine, more = random.Random(f"{seed} {number} {depth} {kept}"), list(known)
                for _ in range(mine.randint(0, 2)):
                    deeper = depth < 2 and mine.random() < 0.5
                    more += branched(mine, more, tick, depth + 1) if deeper else [mixed(mine, more)]
                if number and kept < 0.7:
                    return tuple(held)
                return tuple(mine.choice((more[-1], mixed(mine, more), mine.choice(more))) for _ in range(count))

            return of

        return list(lax.cond(tick % every == 0, branch(0), branch(1)))

    def function(_: Any, state: Any, tick: Any) -> Any:
        choose, known = random.Random(seed), list(state)
        for _ in range(choose.randint(2, 5)):
            known += branched(choose, known, tick, 0) if choose.random() < 0.6 else [mixed(choose, known)]
        return tuple(choose.choice((known[-1 - i], mixed(choose, known), known[i])) for i in range(LEAVES))

    return function


@pytest.mark.parametrize(
    ("mode", "programs"),
    [
        pytest.param(
            mode,
            count,
            id=f"{name}-{count}",
            marks=pytest.mark.nightly if count == 60 else pytest.mark.long if mode.lanes != 16 or count > 1 else (),
        )
        for mode, name in zip(MODES, IDS, strict=True)
        for count in (1, 12, 60)
    ],
)
def test_branches_read_the_state_before_it_is_changed(mode: Mode, programs: int) -> None:
    for seed in range(programs):
        size = (17, 7)[seed % 2]
        state = tuple(np.random.default_rng(seed).normal(size=(LEAVES, 2, 3, size)).astype(np.float32))
        check(branching(seed + 2), state, mode, rtol=2e-5, atol=1e-5, ticks=7)


@pytest.mark.parametrize("mode", [Mode(16, False), Mode(8, True)], ids=["elements16", "worlds8"])
def test_what_a_branch_holds_is_not_copied(mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a sensor: a state and a reading, new at every fifth tick, the reading then looked at again."""
    copied = []
    monkeypatch.setattr(Loops, "copy", lambda self, access, shape, to, keep=None: copied.append(shape))

    def function(state: Any, tick: Any) -> Any:
        memory, reading, flies = state

        def looked() -> tuple[Any, Any]:
            return lax.cond(tick % 10 == 0, lambda: (memory * 0.5, memory + 1.0), lambda: (memory, reading))

        memory, said = lax.cond(tick % 5 == 0, looked, lambda: (memory, reading))
        return memory, jnp.where(flies > 0.0, said, jnp.nan), flies

    build(function, [Input(Packer((np.zeros((3, 40), np.float32),) * 3), own=True)], mode)
    assert copied == []


@pytest.mark.parametrize("mode", [Mode(16, False), Mode(8, True)], ids=["elements16", "worlds8"])
def test_a_chain_of_branchings_is_not_copied(mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a filter: predicted at every tick, then corrected by one sensor and by another, at ticks of their own."""
    copied = []
    monkeypatch.setattr(Loops, "copy", lambda self, access, shape, to, keep=None: copied.append(shape))

    def function(memory: Any, tick: Any) -> Any:
        found = memory * 1.5
        for period in (2, 3, 5):
            found = lax.cond(tick % period == 0, lambda x: x - 0.1 * x, lambda x: x, found)
        return found

    build(function, [Input(Packer(np.zeros((3, 40), np.float32)), own=True)], mode)
    assert copied == []


@pytest.mark.parametrize("lanes", [16, pytest.param(8, marks=pytest.mark.long)])
def test_a_loop_puts_parts_where_the_state_lies(lanes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces of rows, at places from below the first row to beyond the last."""
    mode, copied, copy = Mode(lanes, False), [], Loops.copy

    def counted(self: Loops, access: Any, shape: Any, to: Any, keep: Any = None) -> None:
        copied.append(shape)
        copy(self, access, shape, to, keep)

    def function(shared: Any, state: Any, tick: Any) -> Any:
        rows, turns = state

        def turn(now: Any) -> Any:
            number, found = now
            part = jnp.arange(20, dtype=jnp.float32) * 0.5 + number.astype(jnp.float32)
            place = (number % 2, 2 * number - 3, number * 7 - 10)
            return number + 1, lax.dynamic_update_slice(found, part[None, None], place)

        return lax.while_loop(lambda now: now[0] < turns, turn, (jnp.int32(0), rows))[1], turns

    monkeypatch.setattr(Loops, "copy", counted)
    rows = np.random.default_rng(4).normal(size=(3, 2, 5, 37)).astype(np.float32)
    check(function, (rows, np.array([0, 3, 6], np.int32)), mode, rtol=0.0, atol=0.0, ticks=2)
    # The part alone, never all rows.
    assert {shape for shape in copied if shape} == {(20,)}
