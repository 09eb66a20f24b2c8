"""The algorithm of training, by hand: advantages, the loss, running moments, and the learner's reward."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.envs.objective import Scaled, _length, _summed, _velocity_ned
from qrsim.studies.learn.moments import Moments
from qrsim.studies.learn.ppo import Algorithm, Rows, Samples, Settings, _advantages, _loss, _rows_of
from qrsim.tasks.learned import View


def test_advantages_stop_at_the_end_of_an_episode() -> None:
    reward = jnp.asarray([[1.0], [2.0], [4.0]], jnp.float32)
    ended = jnp.asarray([[False], [True], [False]])
    settings = Settings(discount=0.5, trace=0.5)
    found = _advantages(reward, jnp.zeros((3, 1)), jnp.full((3, 1), 8.0), ended, settings)
    # Errors 5, 6 and 8; the first adds a quarter of the second, and the second nothing of the third.
    np.testing.assert_allclose(found[:, 0], [6.5, 6.0, 8.0])


def test_a_ratio_beyond_the_clip_gains_nothing() -> None:
    identity = [(jnp.eye(1, dtype=jnp.float32), jnp.zeros(1, jnp.float32))]
    weights = {"policy": identity, "value": identity, "log_spread": jnp.zeros(1, jnp.float32)}
    flat = jnp.zeros(2, jnp.float32)
    # Both outputs are as likely as can be, e times as likely as they were: the ratio of the good one is clipped at 1.2.
    part = Rows(flat[None], flat[None], flat - 1.0, jnp.asarray([1.0, -1.0], jnp.float32), flat)
    loss, _ = jax.jit(partial(_loss, Settings()))(weights, part)
    assert float(loss) == pytest.approx(-(1.2 - np.e) / 2.0, rel=1e-5)


def test_the_loss_of_two_decisions_by_hand() -> None:
    identity = [(jnp.eye(1, dtype=jnp.float32), jnp.zeros(1, jnp.float32))]
    weights = {"policy": identity, "value": identity, "log_spread": jnp.full(1, np.log(0.5), jnp.float32)}
    # Two deviations of 0.5 from the mean, and none; densities have grown by exp(0.1) and fallen by as much.
    before = jnp.asarray([-2.0 + np.log(2.0) - 0.1, np.log(2.0) + 0.1], jnp.float32)
    advantage, target = jnp.asarray([1.0, -1.0], jnp.float32), jnp.asarray([0.0, 5.0], jnp.float32)
    part = Rows(jnp.asarray([[1.0, 2.0]]), jnp.asarray([[2.0, 2.0]]), before, advantage, target)
    loss, divergence = jax.jit(partial(_loss, Settings(entropy_weight=0.1)))(weights, part)
    # Half of the mean square of 1 and -3, less the mean gain sinh(0.1), less a tenth of log 0.5.
    assert float(loss) == pytest.approx(2.5 - 0.10016675 + 0.06931472, rel=1e-5)
    assert float(divergence) == pytest.approx(0.00500417, rel=1e-3)


def test_values_beyond_a_time_limit_count_and_those_beyond_a_crash_do_not() -> None:
    # The value is the input. Episode 0 goes on, 1 is cut off where the value is 5, and 2 has crashed.
    weights = {"value": [(jnp.eye(1, dtype=jnp.float32), jnp.zeros(1, jnp.float32))]}
    inputs = jnp.asarray([[1.0, 1.0, 1.0], [3.0, 7.0, 7.0]])[..., None]
    ended, beyond = jnp.asarray([[False, True, True]]), jnp.asarray([[0.0, 5.0, 0.0]])
    given = Samples(inputs, jnp.ones((1, 3, 1)), jnp.full((1, 3), -0.5), jnp.full((1, 3), 2.0), ended, beyond)
    found = jax.jit(partial(_rows_of, settings=Settings(discount=0.5)))(weights, given)
    np.testing.assert_allclose(found.target, [3.5, 4.5, 2.0])
    np.testing.assert_allclose(found.advantage, [2.5, 3.5, 1.0])
    np.testing.assert_allclose(found.log_density, [-0.5, -0.5, -0.5])


def test_a_decision_is_the_mean_and_its_noise() -> None:
    view = View("made", 0, 0.1, ("a", "b"), ("c",), (0, 1), (), None, (0,), (0.25,), (0.5,))
    layer = [(jnp.ones((3, 1), jnp.float32), jnp.zeros(1, jnp.float32))]
    weights = {"policy": layer, "log_spread": jnp.log(jnp.full(1, 0.5, jnp.float32))}
    scaling = np.array([1.0, 1.0, 0.0], np.float32), np.array([2.0, 1.0, 1.0], np.float32)
    seen, last = np.array([[3.0, 0.5]], np.float32), np.array([[0.125]], np.float32)
    found = Algorithm(view, Settings()).decide(weights, scaling, seen, last, np.full((1, 1), 2.0, np.float32))
    np.testing.assert_allclose(found.features, [[3.0, 0.5, 0.125]])
    # Scaled inputs 1, -0.5 and 0.125, then two deviations of 0.5.
    np.testing.assert_allclose(found.outputs, [[1.625]])
    # 0.25 + 0.5 * 1.625, limited.
    np.testing.assert_allclose(found.action, [[1.0]])


def test_moments_are_those_of_all_rows() -> None:
    rows = np.random.default_rng(1).normal([3.0, -2.0], [0.5, 4.0], (1000, 2)).astype(np.float32)
    moments = Moments(2)
    for part in np.split(rows, [10, 11, 600]):
        moments.add(part)
    found = moments.scaling()
    np.testing.assert_allclose(found.mean, [3.0, -2.0], atol=0.3)
    np.testing.assert_allclose(found.mean, rows.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(found.deviation, rows.std(axis=0) + 1e-3, rtol=1e-5)


def test_rewards_are_scaled_by_the_deviation_of_their_sums() -> None:
    batch: Any = SimpleNamespace(size=2, agents=("a",))
    scaled = Scaled(batch, 0.0)
    scaled.begin(batch)
    going = np.zeros(2, bool)
    for _ in range(50):
        found = scaled.reward(batch, np.array([[300.0], [-300.0]]), going, np.zeros((2, 1)))
    np.testing.assert_allclose(found, [1.0, -1.0], rtol=1e-3)
    again = Scaled(batch, 0.0)
    again.restore(scaled.state())
    again.begin(batch)
    np.testing.assert_array_equal(
        again.reward(batch, np.array([[1.0], [2.0]]), going, found),
        scaled.reward(batch, np.array([[1.0], [2.0]]), going, found),
    )


def test_lengths_and_short_sums_have_every_part() -> None:
    np.testing.assert_allclose(_length(np.array([[[3.0, 4.0, 12.0]], [[2.0, 3.0, 6.0]]])), [13.0, 7.0])
    np.testing.assert_allclose(_summed(np.array([[1.0, 20.0, 300.0, 4000.0], [5.0, 0.0, 0.0, 1.0]])), [4321.0, 6.0])
    np.testing.assert_allclose(_summed(np.array([[7.0]])), [7.0])


def test_velocities_in_body_axes_are_turned_into_those_over_ground() -> None:
    # Heading east and pitched up by 30 degrees, 2 m/s forwards: 1.732 east and 1 up.
    truth = {"attitude": np.array([[[0.0, np.pi / 6, np.pi / 2]]]), "velocity_body": np.array([[[2.0, 0.0, 0.0]]])}
    np.testing.assert_allclose(_velocity_ned(truth), [[[0.0, 1.7320508, -1.0]]], atol=1e-7)
    # Banked by 90 degrees to the right, the body's right is down.
    banked = {"attitude": np.array([[[np.pi / 2, 0.0, 0.0]]]), "velocity_body": np.array([[[0.0, 3.0, 0.0]]])}
    np.testing.assert_allclose(_velocity_ned(banked), [[[0.0, 0.0, 3.0]]], atol=1e-7)
