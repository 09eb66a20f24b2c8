"""Operations of symmetric matrices in machine code, against JAX on the same numbers, in each way of using vectors."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from tests.engine.llvm.test_operations import IDS, MODES, check

from qrsim.core.symmetric import Term, lowered, times, transformed
from qrsim.engine.layout import Packer
from qrsim.engine.llvm import Input, Mode, UnsupportedError, build
from qrsim.engine.llvm import compiler as machine

SIZE, WORLDS = 6, 18
SHARED = {"noise": np.float32(0.5), "column": np.array([0.1, -0.2, 0.3, 0.0, 0.2, 0.1], np.float32)}
TERMS = (Term(0, 2, 0.02), Term(1, 5, -1.0, 0), Term(1, 2, -0.5, 1), Term(2, 3, 1.0, 2), Term(2, 4, 1.0, 0))


def stepped(shared: Any, state: Any, tick: Any) -> Any:
    """Return a state after all three operations, which read numbers that are shared, known, and each world's own."""
    moved = transformed(state["half"], TERMS, list(state["factors"]), {0: shared["noise"], 5: state["own"]})
    column = times(moved, {1: state["factors"][0], 5: jnp.ones_like(state["own"]), 0: shared["noise"] + state["own"]})
    wider = transformed(moved, (), (), {3: shared["noise"]})
    same = jnp.broadcast_to(shared["column"][:, None], column.shape)
    return {**state, "half": lowered(wider, [state["column"], 0.01 * column, same]), "found": column}


def state_of(count: int) -> dict[str, Any]:
    random = np.random.default_rng(4)
    root = random.normal(size=(WORLDS, count, SIZE, SIZE))
    upper = np.triu_indices(SIZE)
    half = (root @ np.swapaxes(root, -1, -2) + np.eye(SIZE))[..., upper[0], upper[1]]
    parts = {
        "half": np.swapaxes(half, 1, 2),
        "factors": random.normal(size=(WORLDS, 3, count)),
        "own": random.uniform(size=(WORLDS, count)),
        "column": 0.1 * random.normal(size=(WORLDS, SIZE, count)),
        "found": np.zeros((WORLDS, SIZE, count)),
    }
    return {name: part.astype(np.float32) for name, part in parts.items()}


@pytest.mark.parametrize("mode", MODES, ids=IDS)
@pytest.mark.parametrize("count", [1, 5, pytest.param(8, marks=pytest.mark.long), 21])
def test_halves_change_as_with_jax(count: int, mode: Mode) -> None:
    check(stepped, state_of(count), mode, rtol=2e-5, atol=2e-5, shared=SHARED, ticks=2)


@pytest.mark.parametrize("mode", [Mode(8, False), Mode(16, True)])
def test_vectors_of_both_widths_give_the_same(mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of processors with registers of 32 and of 64 bytes: texts differ, numbers do not."""
    for width in (32, 64):
        for module in ("halves", "writing"):
            monkeypatch.setattr(f"qrsim.engine.llvm.{module}.vector_bytes", lambda width=width: width)
        check(stepped, state_of(5), mode, rtol=2e-5, atol=2e-5, shared=SHARED, ticks=2)
    assert machine.vector_bytes() in (32, 64)


def test_one_number_is_no_matrix() -> None:
    """Such a half has no rows to go through, and XLA compiles it."""
    inputs = [Input(Packer(()), own=False), Input(Packer({"half": np.zeros((1, 3), np.float32)}), own=True)]
    with pytest.raises(UnsupportedError, match="half_transformed"):
        build(
            lambda _, state, tick: {"half": transformed(state["half"], (), (), {0: jnp.float32(1.0)})},
            inputs,
            Mode(16, False),
        )
