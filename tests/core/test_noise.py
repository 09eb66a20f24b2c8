"""Random draws: the generator against its published answers, the structure of streams, statistics, OU."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.core import noise_statistics as study

from qrsim.core.noise import Draw, Key, Stream, ou_decay, ou_step, threefry2x32
from qrsim.studies.validate.statistics import family_summary, p_values

F32 = jnp.dtype(jnp.float32)
# Low and high word, as a program is given a seed that it is not compiled for.
SEED = np.array([20140914, 3], np.uint32)
TICK, STREAM = np.uint32(77), "process"
# Sizes around vector widths, where compiled loops change form.
SIZES = (1, 3, 8, 17, 1000)

# Random123 1.14, kat_vectors: rounds, counter, key -> output.
KNOWN_ANSWERS = (
    "13 00000000 00000000 00000000 00000000 -> 9d1c5ec6 8bd50731",
    "13 ffffffff ffffffff ffffffff ffffffff -> fd36d048 2d17272c",
    "13 243f6a88 85a308d3 13198a2e 03707344 -> ba3e4725 f27d669e",
    "20 00000000 00000000 00000000 00000000 -> 6b200159 99ba4efe",
    "20 ffffffff ffffffff ffffffff ffffffff -> 1cb996fc bb002be7",
    "20 243f6a88 85a308d3 13198a2e 03707344 -> c4923a9c 483df7a0",
)


def uint32(values: Any) -> jax.Array:
    return jnp.asarray(values, jnp.uint32)


def draw(keys: Stream, ids: jax.Array, count: int = 4) -> jax.Array:
    """Normals of shape (count, n)."""
    return jnp.stack(Stream(keys.high, keys.low, ids).normals(TICK, count, F32))


jitted: Callable[..., jax.Array] = jax.jit(draw, static_argnums=2)
# The stream's key words, computed once: the programs below are not compiled for them.
keys_of = jax.jit(lambda world: Key.root(SEED, world).stream(STREAM, jnp.zeros(1, jnp.uint32)))


@pytest.fixture(scope="module")
def keys() -> Stream:
    """The stream of world 0; its ids are replaced."""
    return keys_of(uint32(0))


@pytest.fixture(scope="module")
def base(keys: Stream) -> np.ndarray[Any, Any]:
    """The draws of ids 0..4999 in world 0, shape (4, 5000)."""
    return np.asarray(jitted(keys, jnp.arange(5000, dtype=jnp.uint32)))


@pytest.fixture(scope="module")
def small() -> dict[str, Any]:
    """The statistics of few draws."""
    return study.family(full=False)


class TestGenerator:
    @pytest.mark.parametrize("compiled", [False, True])
    @pytest.mark.parametrize("line", KNOWN_ANSWERS)
    def test_known_answers(self, line: str, compiled: bool):
        given, _, expected = line.partition(" -> ")
        rounds, *words = given.split()
        counter0, counter1, key0, key1 = (uint32(int(word, 16)) for word in words)
        function = jax.jit(threefry2x32, static_argnums=2) if compiled else threefry2x32
        out = function((key0, key1), (counter0, counter1), int(rounds))
        assert [f"{int(word):08x}" for word in out] == expected.split()

    def test_simulator_uses_thirteen_rounds(self):
        key, counter = (uint32(1), uint32(2)), (uint32(3), uint32(4))
        assert [int(w) for w in threefry2x32(key, counter)] == [int(w) for w in threefry2x32(key, counter, 13)]

    def test_words_are_a_function_of_key_tick_id_and_index(self):
        stream = Stream(uint32(11), uint32(12), uint32([5, 6]))
        words = stream.words(uint32(9), 3)
        expected = threefry2x32((uint32(11), uint32(15)), (uint32([9, 9]), uint32([5, 6])))
        for word, want in zip(words, expected, strict=True):
            np.testing.assert_array_equal(word, want)


class TestStructure:
    @pytest.mark.parametrize("n", SIZES)
    def test_more_ids_change_nothing(self, keys, base, n: int):
        np.testing.assert_array_equal(jitted(keys, jnp.arange(n, dtype=jnp.uint32)), base[:, :n])

    def test_order_of_ids_changes_nothing(self, keys, base):
        order = np.random.default_rng(0).permutation(5000)
        np.testing.assert_array_equal(jitted(keys, uint32(order)), base[:, order])

    def test_gaps_in_ids_change_nothing(self, keys, base):
        ids = np.asarray([4999, 17, 4])
        np.testing.assert_array_equal(jitted(keys, uint32(ids)), base[:, ids])

    @pytest.mark.parametrize("count", [1, 3, 7])
    def test_more_draws_change_nothing(self, keys, base, count: int):
        ids = jnp.arange(100, dtype=jnp.uint32)
        common = min(count, 4)
        np.testing.assert_array_equal(jitted(keys, ids, count)[:common], base[:common, :100])

    def test_vmap_over_worlds_changes_nothing(self):
        ids, worlds = jnp.arange(37, dtype=jnp.uint32), uint32([0, 1, 5, 2**32 - 1])

        def one(world: jax.Array, ids: jax.Array) -> jax.Array:
            return draw(Key.root(SEED, world).stream(STREAM, ids), ids)

        together = np.asarray(jax.jit(jax.vmap(one, in_axes=(0, None)))(worlds, ids))
        alone = [np.asarray(jitted(keys_of(world), ids)) for world in worlds]
        np.testing.assert_array_equal(together, alone)
        assert len(np.unique(together[:, 0, 0])) == 4

    def test_ids_and_tick_that_the_compiler_knows_change_nothing(self, keys, base):
        """A program that closes over its ids and a first tick, as a reset does."""
        ids = jnp.arange(5000, dtype=jnp.uint32)
        np.testing.assert_array_equal(jax.jit(lambda keys: draw(keys, ids))(keys), base)

    @pytest.mark.parametrize("n", [17, 5000])
    def test_a_program_that_consumes_the_draws_returns_the_same(self, keys, base, n: int):
        @jax.jit
        def program(keys: Stream, ids: jax.Array, state: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
            normals = draw(keys, ids)
            for _ in range(3):
                state = 0.9 * state + normals[0] * normals[1] + 2.0 * jnp.abs(normals[2])
            return normals, state, jnp.sum(normals * normals)

        normals, _, _ = program(keys, jnp.arange(n, dtype=jnp.uint32), jnp.ones(n, F32))
        np.testing.assert_array_equal(normals, base[:, :n])

    @pytest.mark.parametrize("n", [1, 1000])
    def test_a_scan_over_ticks_draws_the_same(self, keys, base, n: int):
        @jax.jit
        def program(keys: Stream, ids: jax.Array) -> jax.Array:
            def tick(state: jax.Array, now: jax.Array) -> tuple[jax.Array, jax.Array]:
                normals = jnp.stack(Stream(keys.high, keys.low, ids).normals(now, 4, F32))
                return 0.5 * state + normals, normals

            return jax.lax.scan(tick, jnp.zeros((4, n), F32), jnp.arange(100, dtype=jnp.uint32))[1]

        np.testing.assert_array_equal(program(keys, jnp.arange(n, dtype=jnp.uint32))[int(TICK)], base[:, :n])

    # XLA fuses a * b + c into one rounding wherever it can, so a normal must not end in a product.
    def test_what_is_consumed_is_what_is_returned(self, keys, base):
        x = np.random.default_rng(1).normal(size=5000).astype(np.float32)
        total = jax.jit(lambda keys, ids, x: x + draw(keys, ids)[0])(keys, jnp.arange(5000, dtype=jnp.uint32), x)
        np.testing.assert_array_equal(total, x + base[0])

    def test_normal_rows_are_the_same_draws(self, keys):
        stream = Stream(keys.high, keys.low, jnp.arange(33, dtype=jnp.uint32))
        rows = np.asarray(jax.jit(lambda s: s.normal_rows(TICK, 5, F32))(stream))
        normals = np.asarray(jax.jit(lambda s: jnp.stack(s.normals(TICK, 6, F32)))(stream))
        # First the cosine outputs of the three pairs, then the sine outputs.
        np.testing.assert_array_equal(rows, normals[[0, 2, 4, 1, 3]])

    def test_normal_rows_do_not_depend_on_other_ids(self, keys):
        @jax.jit
        def rows(keys: Stream, ids: jax.Array) -> jax.Array:
            return Stream(keys.high, keys.low, ids).normal_rows(TICK, 7, F32)

        many = np.asarray(rows(keys, jnp.arange(1000, dtype=jnp.uint32)))
        for ids in ([3], [999, 0, 3], list(range(17))):
            np.testing.assert_array_equal(rows(keys, uint32(ids)), many[:, ids])

    def test_draw_hands_out_the_stream_at_its_tick(self):
        handed = Draw(Stream(uint32(11), uint32(12), uint32([5, 6])), TICK, jnp.zeros((), F32))
        assert handed.shape == (2,)

        @jax.jit
        def both(handed: Draw) -> Any:
            stream = handed.stream
            expected = stream.normals(TICK, 3, F32), stream.normal_rows(TICK, 3, F32)
            return (handed.normals(3), handed.normal_rows(3)), expected

        for found, expected in zip(*map(jax.tree.leaves, both(handed)), strict=True):
            np.testing.assert_array_equal(found, expected)

    @pytest.mark.parametrize("seed", [0, 1, 20140914, 2**32 - 1, 2**40 + 5, 2**63 - 1])
    def test_integer_seed_equals_traced_seed(self, seed: int):
        traced = jax.jit(lambda s, w: Key.root(s, w))(uint32([seed % 2**32, seed // 2**32]), uint32(3))
        given = Key.root(seed, 3)
        assert (int(given.high), int(given.low)) == (int(traced.high), int(traced.low))

    def test_families_are_the_streams_of_each(self):
        key = Key.roots(np.array([1, 2**40 + 5]), np.array([0, 3]))
        groups = [["sky"], [], ["gnss", "imu", "sky"]]
        found = key.families(groups)
        assert [keys.high.shape for keys in found] == [(2, 1), (2, 0), (2, 3)]
        for names, keys in zip(groups, found, strict=True):
            for word, expected in zip(jax.tree.leaves(keys), jax.tree.leaves(key.streams(names)), strict=True):
                np.testing.assert_array_equal(word, expected)
        # Of a name, the same whatever stands beside it.
        np.testing.assert_array_equal(found[0].high[:, 0], found[2].high[:, 2])

    def test_each_part_of_the_name_of_a_draw_matters(self):
        ids = jnp.arange(8, dtype=jnp.uint32)

        def first(seed: int = 1, world: int = 2, name: str = "a", tick: int = 3) -> tuple[int, ...]:
            words = Key.root(seed, world).stream(name, ids).words(uint32(tick), 0)
            return tuple(np.asarray(words[0]).tolist())

        drawn = [first(), first(seed=2), first(seed=1 + 2**32), first(world=1), first(name="b"), first(tick=4)]
        # Also no id repeats another's words.
        assert len(set(drawn)) == len(drawn)
        assert len({word for words in drawn for word in words}) == 8 * len(drawn)

    def test_eager_is_close_to_jitted(self, keys, base):
        eager = np.asarray(draw(keys, jnp.arange(5000, dtype=jnp.uint32), 2))
        np.testing.assert_allclose(eager, base[:2], rtol=0, atol=1e-6)

    def test_double_precision_is_close_to_single(self, keys, base):
        with jax.enable_x64(True):
            stream = Stream(keys.high, keys.low, jnp.arange(5000, dtype=jnp.uint32))
            double = np.asarray(jax.jit(lambda s: jnp.stack(s.normals(TICK, 4, jnp.dtype(jnp.float64))))(stream))
        assert double.dtype == np.float64
        # The uniform is rounded to 2**-25 near 1 and log and sincos have errors of some 1e-7, so that the radius r
        # is off by 1e-7 (1 + r + 1/r) or so, and the angle by 2e-7, which counts r times; 3 is the allowance.
        radius = np.repeat(np.hypot(double[0::2], double[1::2]), 2, axis=0)
        assert np.all(np.abs(base - double) < 3e-7 * (1.0 + radius + 1.0 / radius))

    def test_extreme_words_give_finite_normals(self):
        # The largest word rounds to a uniform of 1, the smallest gives the largest magnitude there is.
        from qrsim.core.noise import _box_muller

        words = uint32([0, 1, 2**31 - 1, 2**31, 2**32 - 1])
        a, b = np.meshgrid(words, words)
        cosine, sine = jax.jit(_box_muller, static_argnums=1)((uint32(a.ravel()), uint32(b.ravel())), F32)
        assert np.all(np.isfinite(cosine))
        assert np.all(np.isfinite(sine))
        assert np.max(np.hypot(cosine, sine)) == pytest.approx(math.sqrt(64.0 * math.log(2.0)), abs=1e-5)


class TestStatistics:
    """Each statistic's p-value against 0.001/K over the K of its family: 99.9 % confidence (Bonferroni)."""

    @pytest.mark.long
    def test_normals(self, small):
        found = small["normals"]
        assert found["draws"] == 9 * 4 * 1024 * 64
        assert found["statistics"] == 62
        assert found["smallest_p"] > found["p_limit"], found

    def test_ornstein_uhlenbeck(self, small):
        found = small["ornstein_uhlenbeck"]
        assert found["statistics"] == 15
        assert found["smallest_p"] > found["p_limit"], found

    @pytest.mark.nightly
    def test_many_draws(self):
        for name, found in study.family(full=True).items():
            assert found["smallest_p"] > found["p_limit"], (name, found)

    def test_the_moments_would_show_a_fault(self):
        good = study.draw("process", (4, 512, 64))
        limit = family_summary(study.moments(good))["p_limit"]
        assert min(p_values(study.moments(good))) > limit
        for bad in (1.02 * good, good + np.float32(0.02), np.clip(good, -3.0, 3.0), good + 0.03 * (good**2 - 1.0)):
            assert min(p_values(study.moments(bad))) < limit

    def test_the_distribution_test_would_show_a_fault(self):
        good = study.draw("process", (4, 512, 64))
        assert study.kolmogorov_smirnov(good)["p"] > 0.001
        assert study.kolmogorov_smirnov(np.round(good * 64.0) / 64.0)["p"] < 0.001
        assert study.kolmogorov_smirnov(1.02 * good)["p"] < 0.001

    def test_the_correlations_would_show_a_fault(self):
        x, y, z = study.draw("process", (3, 512, 64))
        assert min(p_values(study.correlation(x, y))) > 0.001 / 2
        # A shared component of 3 % shows in the product, a shared magnitude only in the squares.
        assert study.correlation(x, 0.03 * x + y)["linear"]["p"] < 0.001 / 2
        shared = study.correlation(x * np.sign(y) * np.sign(z), np.abs(x) * np.sign(y))
        assert shared["linear"]["p"] > 0.001
        assert shared["squares"]["p"] < 0.001 / 2


class TestOrnsteinUhlenbeck:
    def test_precision_of_the_decay(self):
        found = study.decay_precision(5001)
        # Single precision: a few roundings of 6e-8; past the series' range 1 - a^2 loses at most two digits.
        assert found["float32"]["spread_below_0_01"] < 2e-7
        assert found["float32"]["spread"] < 3e-6
        assert found["float32"]["decay"] < 1e-6
        # Double: the series' first omitted term, 4/15 x^5, is 6.7e-10 of the square root at x = 0.01.
        assert found["float64"]["spread"] < 7e-10
        assert found["float64"]["decay"] < 1e-15
        # The rounded pair settles at the stated standard deviation to 0.2 % for dt/tau of 1e-5 and more.
        assert found["float32"]["stationary_std"] < 2e-3
        # What the series is there for: the plain form is wrong by a per cent.
        assert found["float32"]["spread_plain"] > 5e-3

    def test_step_is_exact_for_any_interval(self):
        # Two steps are one step of the sum: means compose, and variances add.
        with jax.enable_x64(True):
            tau = jnp.asarray(3.0)
            for dt in (1e-4, 0.02, 3.0, 30.0):
                a, b = ou_decay(dt, tau)
                a2, b2 = ou_decay(2.0 * dt, tau)
                assert float(a * a) == pytest.approx(float(a2), rel=1e-12)
                assert float((a * b) ** 2 + b**2) == pytest.approx(float(b2**2), rel=2e-9)

    def test_step_is_linear_in_its_inputs(self):
        value, normal = jnp.asarray([1.0, -2.0], F32), jnp.asarray([0.5, 3.0], F32)
        std, tau = jnp.asarray(2.0, F32), jnp.asarray(10.0, F32)
        stepped = ou_step(value, normal, 2.0, std, tau)
        a = math.exp(-0.2)
        expected = a * np.asarray(value) + 2.0 * math.sqrt(1.0 - a * a) * np.asarray(normal)
        np.testing.assert_allclose(stepped, expected, rtol=1e-6)

    def test_allan_variance_has_its_known_limits(self):
        # White at long windows, a random walk at short ones.
        assert study.allan_variance(2.0, 3.0, 3e4) == pytest.approx(4.0 * 2.0 * 3.0 / 3e4, rel=2e-4)
        assert study.allan_variance(2.0, 3.0, 3e-2) == pytest.approx(4.0 * 2.0 / 3.0 * 0.01, rel=0.02)
