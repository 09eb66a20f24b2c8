"""Trainings that start with the baseline or a policy file, and those of one fleet of several."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from qrsim import cli
from qrsim.errors import UsageError
from qrsim.studies.learn import imitating
from qrsim.studies.learn.folder import make_folder, restore, save
from qrsim.studies.learn.imitating import Fit
from qrsim.studies.learn.suited import plan_of
from qrsim.studies.learn.training import Plan, Training
from qrsim.tasks.learned import forward, read_policy

MOUSE = ("duration=5", "task.mouse=agent")


def test_a_regression_finds_a_line() -> None:
    fit = Fit([(np.zeros((1, 1), np.float32), np.zeros(1, np.float32))])
    rng = np.random.default_rng(1)
    inputs = rng.normal(size=(500, 1)).astype(np.float32)
    fit.improve(inputs, 0.3 * inputs - 0.2, np.full(250, 0.01, np.float32), rng)
    (weights, offset), *_ = fit.layers
    np.testing.assert_allclose([weights[0, 0], offset[0]], [0.3, -0.2], atol=0.01)


@pytest.fixture(scope="module")
def _brief() -> object:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"ROUNDS": 2, "BLOCKS": 1, "LAST_BLOCKS": 1, "STEPS": 50, "ROWS": 64}.items():
            patch.setattr(imitating, name, value)
        yield


def brief(**changes: object) -> Plan:
    """Return the plan of a mouse that flees from cats, with one cycle of 4 episodes of 5 s."""
    plan = plan_of("cats_and_mouse/1A", MOUSE, 4, fleet="mice", tries=4, steps=2000)
    return dataclasses.replace(plan, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def mouse(_brief: object, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a training of two cycles; the first is that of the start."""
    folder = tmp_path_factory.mktemp("mouse")
    training = Training(brief())
    make_folder(folder)
    for _ in training.cycles():
        save(training, folder)
        (folder / f"cycle_{training.cycle}.npz").write_bytes(training._policy().content())
        (folder / f"best_{training.cycle}.npz").write_bytes((folder / "policy.npz").read_bytes())
    return folder


@pytest.mark.long
def test_a_mouse_starts_with_the_baseline_and_is_scored(mouse: Path, capsys: pytest.CaptureFixture[str]) -> None:
    policy = read_policy(mouse / "policy.npz")
    assert (policy.view.fleet, policy.view.observed[4]) == ("mice", "cat_0_offset_north")
    words = ["score", "cats_and_mouse/1A", "--policy", str(mouse / "policy.npz"), "--seeds", "2", "--json"]
    assert cli.main([*words, *(word for each in MOUSE for word in ("--set", each))]) == 0
    learned, *_ = json.loads(capsys.readouterr().out)["policies"]
    assert learned["others"]["mice"]["mean"] == pytest.approx(-learned["mean"])
    # As the only agents, cats are flown by another policy.
    assert cli.main(words) == 2
    assert "it flies fleet 'mice'; agents of this task are cats" in capsys.readouterr().err


@pytest.mark.long
def test_a_start_is_a_policy_file_and_fits(mouse: Path) -> None:
    start = str(mouse / "cycle_1.npz")
    training = Training(brief(start=start, steps=1))
    first = read_policy(start)
    list(training.cycles())
    # The first cycle learns the value alone: the policy that is tried is that of the file.
    inputs = np.random.default_rng(0).normal(size=(5, 12)).astype(np.float32)
    found = training._policy()
    np.testing.assert_array_equal(found.scaling.deviation, first.scaling.deviation)
    np.testing.assert_array_equal(forward(found.layers, inputs), forward(first.layers, inputs))
    wide = dataclasses.replace(training.plan.settings, width=8)
    with pytest.raises(UsageError, match=r"its layers are 12 x 64, .*; this training's are 12 x 8, 8 x 8, 8 x 2"):
        Training(brief(start=start, settings=wide))
    with pytest.raises(UsageError, match="it was trained on cats_and_mouse_1A"):
        Training(plan_of("keep_spot", start=start))


@pytest.mark.long
def test_a_training_goes_on_without_its_start(mouse: Path) -> None:
    other = Training(brief(), begins=False)
    assert restore(other, mouse) == ""
    assert other.best is not None
    assert other.best[0].content() == (mouse / "policy.npz").read_bytes()
    np.testing.assert_array_equal(other.moments.scaling().mean, read_policy(mouse / "policy.npz").scaling.mean)


@pytest.mark.long
def test_others_are_flown_by_a_policy_file(mouse: Path) -> None:
    file = str(mouse / "policy.npz")
    with pytest.raises(UsageError, match="it flies fleet 'mice', which learns"):
        Training(brief(others=file))
    cats = Training(brief(others=file, fleet="cats", start=None))
    assert (cats.view.fleet, len(cats.view.observed), cats.flights.rows) == ("cats", 10, 12)
    # Against this mouse, cats that stand still are where they are against the mouse of the baseline, but it is not.
    mice = [Training(brief(others=others, fleet="cats", start=None)).trials for others in (file, None)]
    for flights in mice:
        flights.fly(lambda inputs: np.zeros((len(inputs), 2), np.float32), np.arange(4))
    learned, script = (flights.seen.reshape(4, 3, 10) for flights in mice)
    np.testing.assert_allclose(learned[..., :2], script[..., :2], atol=0.01)
    assert np.abs(learned[..., 4:6] - script[..., 4:6]).max() > 0.05
