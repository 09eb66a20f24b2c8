"""Trees to flat buffers and back, bit for bit."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3
from qrsim.engine.layout import Packer


@record
class Mixed:
    """One leaf of every kind that a state holds."""

    position: Vec3 = quantity(unit="m")
    alive: Any = quantity()
    ids: Any = quantity()
    counts: Any = quantity()
    scalar: Any = quantity()
    matrix: Any = quantity()
    empty: Any = quantity()


def tree(seed: int = 0, precision: str = "float32") -> Mixed:
    rng = np.random.default_rng(seed)

    def floats(*shape: int) -> jax.Array:
        return jnp.asarray(rng.normal(size=shape), precision)

    return Mixed(
        Vec3(floats(5), floats(5), floats(5)),
        jnp.asarray(rng.integers(0, 2, 5).astype(bool)),
        # All 32 bits in use: a conversion by value would overflow.
        jnp.asarray(np.asarray([0, 1, 2**31 - 1, 2**31, 2**32 - 1], np.uint32) ^ np.uint32(seed)),
        jnp.asarray(np.asarray([-(2**31), -1, 2**31 - 1], np.int32)),
        floats(),
        floats(2, 3),
        jnp.zeros((0,), precision),
    )


def assert_same(found: Any, expected: Any) -> None:
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert a.dtype == b.dtype
        assert a.shape == b.shape
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_round_trip(precision: str, compiled: bool):
    with jax.enable_x64(precision == "float64"):
        state = tree(precision=precision)
        packer = Packer(state)
        pack, unpack = (jax.jit(packer.pack), jax.jit(packer.unpack)) if compiled else (packer.pack, packer.unpack)
        buffers = pack(state)
        assert [b.dtype for b in buffers] == [np.dtype(precision), np.int32]
        assert tuple(b.shape[0] for b in buffers) == packer.sizes == (22, 13)
        assert_same(unpack(buffers), state)


def test_round_trip_on_the_host():
    state = tree()
    packer = Packer(state)
    buffers = tuple(np.asarray(b) for b in packer.pack(state))
    found = packer.unpack(buffers)
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(found))
    assert_same(found, state)
    # Views, not copies, where the type needs no change.
    assert np.shares_memory(found.position.x, buffers[0])
    assert np.shares_memory(found.ids, buffers[1])


def test_a_tree_on_the_host_is_packed_there():
    state = jax.tree.map(np.asarray, tree())
    packer = Packer(state)
    buffers = packer.pack(state)
    assert all(isinstance(buffer, np.ndarray) for buffer in buffers)
    for found, expected in zip(buffers, packer.pack(tree()), strict=True):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)
    assert_same(packer.unpack(buffers), state)


@pytest.mark.parametrize("batch", [(4,), (2, 3), (1,)])
def test_leading_batch_axes_on_the_host(batch: tuple[int, ...]):
    """A log of many steps or worlds is unpacked in one go; the batch axes lead each leaf."""
    count = int(np.prod(batch))
    states = [tree(seed) for seed in range(count)]
    packer = Packer(states[0])
    packed = [packer.pack(state) for state in states]
    stacked = tuple(np.stack([np.asarray(p[i]) for p in packed]).reshape(*batch, -1) for i in range(2))
    expected = jax.tree.map(lambda *leaves: np.stack(leaves).reshape(*batch, *leaves[0].shape), *states)
    assert_same(packer.unpack(stacked), expected)


def test_batched_by_vmap():
    states = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[tree(seed) for seed in range(3)])
    packer = Packer(tree())
    assert_same(jax.vmap(packer.unpack)(jax.vmap(packer.pack)(states)), states)


def test_a_template_of_shapes_is_enough():
    state = tree()
    packer = Packer(jax.eval_shape(lambda: tree()))
    assert_same(packer.unpack(packer.pack(state)), state)


@pytest.mark.parametrize("only", [{"a": np.arange(3, dtype=np.int32)}, {"a": np.ones(3, np.float32)}])
def test_one_kind_alone(only: Any):
    packer = Packer(only)
    assert_same(packer.unpack(packer.pack(only)), only)


def test_special_values_survive():
    state = {"a": jnp.asarray([np.nan, np.inf, -np.inf, -0.0], jnp.float32)}
    found = Packer(state).unpack(Packer(state).pack(state))
    np.testing.assert_array_equal(np.asarray(found["a"]).view(np.uint32), np.asarray(state["a"]).view(np.uint32))


def test_packers_of_one_structure_are_equal():
    """As a static argument of a jitted function, an equal packer must not compile anew."""
    assert Packer(tree(0)) == Packer(tree(1))
    assert hash(Packer(tree(0))) == hash(Packer(tree(1)))
    for other in (
        jax.tree.map(lambda x: x[None], tree()),
        jax.tree.map(lambda x: x.astype(bool), tree()),
        {"a": tree()},
    ):
        assert Packer(other) != Packer(tree())


def test_mixed_precision_is_refused():
    mixed = {"a": jax.ShapeDtypeStruct((2,), np.float32), "b": jax.ShapeDtypeStruct((2,), np.float64)}
    with pytest.raises(TypeError, match=r"float32.*float64"):
        Packer(mixed)
