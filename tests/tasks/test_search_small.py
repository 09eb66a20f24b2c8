"""The search by numbers: what is observed of a picture, the baseline, and the learner's reward."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from evidence.returns import fly

from qrsim.envs.batch import Batch
from qrsim.envs.objective import Searched, objective_of
from qrsim.tasks.baselines import baseline
from qrsim.tasks.baselines.spotting import Spotting

AREA = SimpleNamespace(x_min=-15.0, x_max=15.0, y_min=-15.0, y_max=15.0, z_min=-20.0)


@pytest.mark.long
def test_the_likeliest_window_shows_a_person_and_the_baseline_finds_all() -> None:
    flown = Batch("search_small", 8)
    flown.reset(range(8))
    assert flown.seen.shape == (8, 1, 12)
    likeliest, truth = flown.seen[:, 0, 9:], {name: part[:, 0] for name, part in flown.truth.items()}
    shown = likeliest[:, :2].any(axis=1)
    # A window is half a metre wide from 10 m. Of 1200 windows noise alone seldom makes one likely.
    one = shown & (truth["missing"] == 1)
    assert one.any()
    np.testing.assert_allclose(likeliest[one, :2], truth["to_person_ned"][one, :2], atol=0.5)
    assert (likeliest[shown, 2] > np.log(1200.0)).all()
    assert (np.abs(likeliest[:, 2]) <= 20.0).all()
    np.testing.assert_allclose(truth["to_person_ned"][:, 2], 10.0, atol=1e-4)
    objective = objective_of(flown, 0.98)
    assert isinstance(objective, Searched)
    # Finding needs 5 m; each other missing person counts 20 m, and one that is not found at least 2 m.
    away = np.maximum(np.linalg.norm(truth["to_person_ned"], axis=-1) - 5.0, 0.0)
    np.testing.assert_allclose(objective.errors(flown), away + 2.0 + 20.0 * (truth["missing"] - 1.0), rtol=1e-5)
    policies = [baseline(flown.functional.play, seed) for seed in range(8)]
    assert isinstance(policies[0], Spotting)
    found, alive = fly(flown, lambda _, seen: np.stack([p.act(each) for p, each in zip(policies, seen, strict=True)]))
    assert alive.all()
    # One for each person, and -1 / 120 for each of the other steps.
    persons = np.round(found + 1.0)
    np.testing.assert_allclose(found, persons - (120.0 - persons) / 120.0, atol=1e-4)
    assert (persons >= 1.0).all()
    assert (flown.truth["missing"] > 0.0).sum() <= 1
    over = flown.truth["missing"][:, 0] == 0.0
    assert (objective.errors(flown)[over] == 0.0).all()
    hovered, _ = fly(flown, 0.0)
    np.testing.assert_allclose(hovered, -1.0, atol=1e-5)


def test_the_baseline_goes_to_a_likely_window_and_else_along_its_pattern() -> None:
    play: Any = SimpleNamespace(axes=[SimpleNamespace(high=3.0)], agents=["one"], world=SimpleNamespace(area=AREA))
    policy = Spotting(play)
    seen = np.zeros((1, 12), np.float32)
    seen[0, :3] = 1.0, 2.0, -10.0
    seen[0, 9:] = 0.0, -8.0, 15.0
    # 8 m west, 7 m too high: both faster than it flies.
    north, east, down = 3.0 * policy.act(seen)[0]
    assert (abs(north) < 1e-6, east, down) == (True, -3.0, pytest.approx(3.0))
    # Nothing likely: to the corner at 6.75 m north and east, from 10 m up to 12 m.
    seen[0, 9:] = 0.0, 0.0, 1.0
    north, east, down = 3.0 * policy.act(seen)[0]
    assert north > 0.0
    assert east > 0.0
    assert down == pytest.approx(-0.9)
    # There, on to the next one.
    seen[0, :2] = 6.0, 6.0
    assert policy.act(seen)[0, 1] < 0.0
