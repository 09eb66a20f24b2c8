"""Reductions along other axes than the last one, whose readers share their loop."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from tests.engine.llvm.test_operations import IDS, MODES, check, numbers, run
from tests.engine.reference import trying
from tests.engine.reference.programs import Draw

from qrsim.engine.layout import Packer
from qrsim.engine.llvm import Input, Mode, build

SIZES = (1, 2, 7, 16, 17, 144, 1000)
TERMS = 5
RATES = np.linspace(-1.5, 2.0, TERMS, dtype=np.float32)[:, None]


def waves(x: Any) -> Any:
    """Sum over (2, TERMS, n), then over (2, n), with weights of each element; its readers are (n,)."""
    inner = jnp.stack([RATES, RATES[::-1]])
    terms = jnp.cos(inner * x[None, None]) + inner
    square = (x * x)[None]
    weights = 1.0 / (1.0 + jnp.array([[1.0], [2.0]], jnp.float32) * square)
    mean = jnp.sum(jnp.sum(terms, axis=1) * weights, axis=0) / x.size
    # Read again by each term, as a normalisation does.
    return mean + jnp.sum(terms[0] * terms[1] / (1.0 + mean * mean)[None], axis=0)


def extremes(x: Any) -> Any:
    """Largest and least of terms with ties, zeros of both signs, NaN and infinity, and where they are."""
    tied = jnp.minimum(RATES * x[None], 1.0)
    largest, least = jnp.max(tied, axis=0), jnp.min(tied, axis=0)
    return largest + least, jnp.argmax(tied, axis=0) * 100 + jnp.argmin(tied, axis=0), tied[1] >= largest


def flags(x: Any) -> Any:
    """Whether all, whether any, how many, the product, and the bits of whole numbers."""
    terms = RATES * x[None]
    above = terms > RATES
    whole = jnp.clip(jnp.nan_to_num(terms), -9.0, 9.0).astype(jnp.int32)
    count = jnp.sum(above, axis=0, dtype=jnp.int32)
    every = jnp.where(jnp.all(above, axis=0), 1.0, jnp.where(jnp.any(above, axis=0), 2.0, 3.0))
    product = jnp.prod(jnp.where(jnp.isfinite(terms), terms, 1.0), axis=0)
    return every * product, count + jnp.sum(whole, axis=0), above[0]


def nothing(x: Any) -> Any:
    """Sums and extremes of no terms."""
    none = jnp.zeros((0, *x.shape), jnp.float32) * x[None]
    return jnp.sum(none, axis=0) + x, jnp.max(none, axis=0, initial=-1.0), jnp.min(none, axis=0, initial=0.5) < x


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "mode",
    [
        pytest.param(mode, id=name, marks=() if mode.lanes == 16 and mode.side_by_side else pytest.mark.long)
        for mode, name in zip(MODES, IDS, strict=True)
    ],
)
def test_sums_and_extremes_of_each_element_are_those_of_jax(mode: Mode) -> None:
    def function(_: Any, state: Any, tick: Any) -> Any:
        return [
            (x, found, waves(jnp.nan_to_num(x, posinf=1.0)), *extremes(x), *flags(x), *nothing(x))
            for x, found, *_ in state
        ]

    state = []
    for size in SIZES:
        x = numbers(size, size, worlds=2)
        shapes = jax.eval_shape(lambda x: (waves(x), *extremes(x), *flags(x), *nothing(x)), x[0])
        state.append((x, x, *(np.zeros((2, *each.shape), each.dtype) for each in shapes)))
    check(function, state, mode, rtol=2e-5, atol=1e-5, ticks=2)


def test_every_way_of_using_vectors_gives_the_same_bits() -> None:
    def function(_: Any, state: Any, tick: Any) -> Any:
        return [x + 0.1 * waves(x) + extremes(x)[0] for x in state]

    state = [np.nan_to_num(numbers(size, size, worlds=2), posinf=2.0) for size in SIZES]
    first, *others = (run(function, state, mode, ticks=3) for mode in MODES)
    for other in others:
        jax.tree.map(np.testing.assert_array_equal, first, other)


@pytest.mark.parametrize("mode", [Mode(16, False), Mode(8, True)], ids=["elements16", "worlds8"])
def test_memory_between_a_reduction_and_its_readers_does_not_grow_with_the_elements(mode: Mode) -> None:
    def needed(size: int) -> int:
        def function(x: Any, tick: Any) -> Any:
            return x + waves(x)

        inputs = [Input(Packer(np.zeros(size, np.float32)), own=True)]
        return build(function, inputs, mode).scratch_bytes

    # Sums (2, n) and weights (2, n) would be 16 bytes more for each.
    assert needed(1600) == needed(160) < 8192


def test_what_other_elements_read_is_whole_before() -> None:
    """Each element reads its neighbours, pairs of them, a place that the program computes, and sums of all."""

    def function(_: Any, state: Any, tick: Any) -> Any:
        x, where = state
        own = jnp.sum(jnp.cos(RATES * x[None]), axis=0)
        turned = jnp.roll(own, 1) + own[where]
        pairs = jnp.sum((own[:, None] - own[None, :]) ** 2, axis=0)
        rows = jnp.stack([own, turned, pairs])
        picked = lax.dynamic_slice(rows, (tick, 0), (1, x.size))[0]
        return jnp.tanh(0.1 * (picked + jnp.max(rows, axis=0) + jnp.mean(own))), where

    for size in (2, 7, 17):
        where = np.random.default_rng(size).integers(0, size, (2, size), np.int32)
        state = (np.nan_to_num(numbers(size, worlds=2), posinf=2.0), where)
        for mode in MODES:
            check(function, state, mode, rtol=2e-5, atol=1e-5, ticks=3)


def test_the_state_is_read_before_it_is_changed() -> None:
    """What becomes the next state may lie where the last one did; later nests still read the last one."""

    def function(_: Any, state: Any, tick: Any) -> Any:
        x, rows = state
        following = rows * 0.5 + jnp.sum(rows, axis=0)[None]
        late = jnp.sum(rows * jnp.tanh(jnp.sum(following, axis=0))[None], axis=0)
        return 0.5 * x + late, following - 0.25 * jnp.roll(rows, 1, axis=0)

    for size in (1, 16, 17, 40):
        drawn = np.random.default_rng(size).normal(size=(2, 4, size)).astype(np.float32)
        state = (drawn[:, 3], drawn[:, :3])
        for mode in MODES:
            check(function, state, mode, rtol=2e-5, atol=1e-5, ticks=2)


def _rows(draw: Draw) -> None:
    """Reduce along all axes but the last, spread what is found, combine it with the terms, and reduce again."""
    x = draw.some(draw.choose.choice("ffiu"), axes=2)
    axes = tuple(range(x.ndim - 1))
    for _ in range(draw.choose.randint(1, 3)):
        how = draw.choose.choice((jnp.max, jnp.min, lambda x, axes: jnp.sum(x, axes, dtype=x.dtype)))
        found = how(x, axes)
        draw.put(found)
        if x.ndim == 2:
            place = lax.argmax(x, 0, draw.words)
            draw.put(place, jnp.take_along_axis(x, place[None], axis=0, mode="clip")[0])
        both = draw.choose.choice((lax.add, lax.sub, lax.max, lax.min))
        other = draw.shaped(draw.choose.choice((found, draw.like(found), jnp.roll(found, 1))), x.shape)
        x = draw.choose.choice((both(x, other), jnp.where(x == other, x, -x)))
        draw.put(x)


@pytest.mark.parametrize(
    "programs", [5, pytest.param(50, marks=pytest.mark.long), pytest.param(200, marks=pytest.mark.nightly)]
)
def test_random_programs_that_reduce_rows(programs: int) -> None:
    outcomes = [trying.tried(3 * 10**9 + number, _rows, longest=3) for number in range(programs)]
    assert [what for what, _ in outcomes if what not in trying.OUTCOMES] == []
    assert sum(what in ("equal", "within") for what, _ in outcomes) > programs / 2
