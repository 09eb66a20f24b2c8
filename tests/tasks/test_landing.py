"""Landing on a pad: the cost of the time in the air, the end of a hard touch, and the baseline."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from evidence.returns import CUT, HOVER, fly

from qrsim.envs.batch import Batch
from qrsim.envs.objective import Landed, objective_of
from qrsim.tasks.baselines import baseline
from qrsim.tasks.landing import Land


@cache
def batch() -> Batch:
    return Batch("land_on_pad", 4, ["task.period=0.1"])


@pytest.mark.long
def test_what_landing_hovering_and_falling_return() -> None:
    """One world: the baseline stands on the pad, hovering pays every second in the air, a fall ends the flight."""
    flown = batch()
    play = flown.functional.play
    policies = [baseline(play, seed) for seed in range(flown.size)]

    def act(_: int, seen: Any) -> Any:
        return np.stack([policy.act(each) for policy, each in zip(policies, seen, strict=True)])

    total, alive = fly(flown, act)
    assert alive.all()
    place = flown.truth["position_ned"][:, 0]
    assert (flown.truth["velocity_body"] == 0.0).all()
    # The pad is at 8 m north, 8 m west; satellites place it a metre or two wrong.
    assert (np.linalg.norm(place - [8.0, -8.0, 0.0], axis=1) < 3.0).all()
    # 12 m to sink at 3 m/s and less, at 1 a second: more than 4 s, less than the whole 30 s.
    assert ((total < -4.0) & (total > -30.0)).all()

    # The pad is 16.5 m away, and all 30 s cost: a hover that does not drift returns -302.
    hovered, alive = fly(flown, HOVER)
    assert alive.all()
    assert (hovered < -30.0).all()

    fallen, alive = fly(flown, CUT)
    assert not alive.any()
    # All the effort for 30 s, 1 for each second, and the farthest corner: (38, 38, 30) m from the pad.
    np.testing.assert_allclose(fallen, -(30.0 * (20.993586 + 1.0) + 3788.0), rtol=1e-5)


@pytest.mark.long
def test_a_learner_is_rewarded_for_standing() -> None:
    flown = batch()
    flown.reset(range(4))
    objective = objective_of(flown, 0.98)
    assert isinstance(objective, Landed)
    flown.truth["velocity_body"][:] = 0.0
    flown.truth["velocity_body"][0] = 0.1
    errors = objective.errors(flown)
    # From (0, 0, -12) to (8, -8, 0) m; the flying one is 2 m farther. Estimates cancel.
    np.testing.assert_allclose(errors, 272.0**0.5 + np.array([2.0, 0.0, 0.0, 0.0]), atol=1e-3)


def test_a_fleet_that_cannot_stand_pays_all_the_time() -> None:
    kind: Any = Land
    zero = np.zeros(2, np.float32)
    command = SimpleNamespace(pitch=zero, roll=zero, throttle=zero + np.float32(0.59), yaw_rate=zero)
    model: Any = SimpleNamespace(vehicle=SimpleNamespace(on_ground=lambda state: None))
    for parked, expected in ((None, [2.5, 2.5]), (np.array([True, False]), [0.0, 2.5])):
        fleet: Any = SimpleNamespace(command=command, parked=parked, vehicle=None)
        cost = kind(airborne=np.float32(2.5)).cost_rate(model, fleet)
        np.testing.assert_allclose(np.asarray(cost), expected, atol=1e-6)
