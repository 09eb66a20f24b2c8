"""Training as a whole: same seed, same bits; a checkpoint goes on with them; one that was cut short gives way."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest

from qrsim.errors import UsageError
from qrsim.studies.learn.folder import make_folder, restore, save
from qrsim.studies.learn.ppo import Settings
from qrsim.studies.learn.suited import plan_of
from qrsim.studies.learn.training import Plan, Training
from qrsim.tasks.learned import forward, read_policy

# A cycle is one iteration of 128 decisions of 16 episodes, 2 s long.
SETTINGS = Settings(width=8, epochs=2, minibatches=8, averaged=0.75)
SMALL = Plan("keep_spot", ("duration=2",), seed=3, envs=16, steps=4096, tries=16, settings=SETTINGS)


def numbers(training: Training) -> list[tuple[float, ...]]:
    """Return the curve without its times."""
    return [dataclasses.astuple(dataclasses.replace(row, seconds=0.0)) for row in training.curve]


@pytest.mark.long
def test_same_seed_same_bits_and_so_after_a_checkpoint(tmp_path: Path) -> None:
    whole = Training(SMALL)
    weights, steps = [], []
    for row in whole.cycles():
        steps.append(row.steps)
        weights.append(np.array(whole.learner.weights["policy"][0][0]))
    assert steps == [2048, 4096]
    # A quarter of the last of two policies and the rest of the first.
    np.testing.assert_allclose(whole.averaged[0][0], 0.75 * weights[0] + 0.25 * weights[1], atol=1e-6)
    make_folder(tmp_path / "whole")
    make_folder(tmp_path / "parts")
    save(whole, tmp_path / "whole")
    # One cycle, and the other by another learner that goes on from its checkpoint.
    first = Training(dataclasses.replace(SMALL, steps=2048))
    for _ in first.cycles():
        save(first, tmp_path / "parts")
    second = Training(SMALL)
    assert restore(second, tmp_path / "parts") == ""
    assert [row.cycle for row in second.cycles()] == [2]
    save(second, tmp_path / "parts")
    assert numbers(second) == numbers(whole)
    assert (tmp_path / "parts" / "policy.npz").read_bytes() == (tmp_path / "whole" / "policy.npz").read_bytes()

    # The last checkpoint is cut short: the one before is used, and said so.
    last = tmp_path / "parts" / "checkpoint.npz"
    last.write_bytes(last.read_bytes()[:-100])
    third = Training(SMALL)
    warning = restore(third, tmp_path / "parts")
    assert warning.endswith(
        "checkpoint.npz: is no checkpoint that this qrsim train has written; "
        "the training goes on from checkpoint_before.npz"
    )
    assert (third.cycle, third.steps) == (1, 2048)
    list(third.cycles())
    assert numbers(third) == numbers(whole)
    last.with_name("checkpoint_before.npz").write_bytes(b"")
    with pytest.raises(UsageError, match="is no NumPy archive of numbers, or it is damaged"):
        restore(Training(SMALL), tmp_path / "parts")

    # Where the time limit cuts episodes off, the value network says what they would still have returned.
    features, cut = whole.flights.features, []
    whole.flights.features = lambda *rows: cut.append(features(*rows)) or cut[-1]  # type: ignore[method-assign]
    samples = whole._fly(whole._drawn(np.random.default_rng(0))[0])
    weights = jax.tree.map(np.asarray, whole.learner.weights)
    # The last inputs are those of the next decision. Episodes of 20 decisions end six times in 128.
    expected = forward(weights["value"], whole.scaling.scaled(np.concatenate(cut[:-1])))[:, 0]
    assert len(expected) > 5 * 16
    np.testing.assert_allclose(samples.beyond[samples.beyond != 0.0], expected, rtol=1e-4, atol=1e-5)
    assert (samples.ended | (samples.beyond == 0.0)).all()
    # Densities are those of Gaussians around the outputs of the network, up to a constant.
    inputs = whole.scaling.scaled(samples.inputs[:-1].reshape(-1, whole.view.inputs))
    away = samples.outputs - forward(weights["policy"], inputs).reshape(samples.outputs.shape)
    spread = np.exp(weights["log_spread"])
    density = -np.sum(0.5 * np.square(away / spread) + np.log(spread), axis=-1)
    np.testing.assert_allclose(samples.log_density, density, atol=2e-4)

    # Of another seed it is another training.
    other = Training(dataclasses.replace(SMALL, seed=4))
    with pytest.raises(UsageError, match=r"the training in .*whole has seed 3; this one has 4"):
        restore(other, tmp_path / "whole")


@pytest.mark.long
def test_a_policy_learns_to_keep_its_place(tmp_path: Path) -> None:
    plan = Plan("keep_spot", envs=128, steps=150_000, seed=1, tries=32)
    training = Training(plan)
    rows = list(training.cycles())
    assert training.best is not None
    policy, best = training.best
    assert best.flown_to_the_end == 1.0
    # Hovering returns some -1500, and its baseline -1.5.
    assert best.mean_return > -20.0
    assert rows[-1].reward > rows[0].reward
    # The file flies as the learner does.
    path = tmp_path / "policy.npz"
    path.write_bytes(policy.content())
    flown = read_policy(path)
    total, alive = training.trials.fly(
        lambda seen: forward(flown.layers, flown.scaling.scaled(seen)), 7 + np.arange(plan.tries)
    )
    assert alive.all()
    assert total.mean() > -20.0


@pytest.mark.nightly
def test_cats_learn_to_come_near_and_to_stay_apart() -> None:
    training = Training(plan_of("cats_and_mouse/1A", ("duration=100",), seed=3, steps=1_000_000, tries=16, start=None))
    rows = list(training.cycles())
    assert training.averaged is not None
    # Cats that stand still lose the mouse within 50 s. At the end they follow it.
    assert rows[0].reward < -0.55
    assert rows[-1].reward > -0.4
    assert training.best is not None
    assert training.best[0].view.ahead == (4, 5)
