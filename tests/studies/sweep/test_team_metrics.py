"""The metrics of the shipped study of independent errors of a team."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.studies.sweep.prepare import plan_of
from qrsim.studies.sweep.study import load_study
from qrsim.studies.sweep.team_metrics import STEPS, TeamErrors, missed_share

pytestmark = pytest.mark.long


def test_what_a_line_passes_by() -> None:
    """Three 10 m apart see 5.5 m to either side: of 20 m, 1 m is missed where one is 2 m off to the side."""
    start = (jnp.zeros((1, 3)), jnp.array([[0.0, 10.0, 20.0]]))
    passed = np.tile(np.array([0.0, 10.0, 20.0])[:, None], (1, STEPS))
    assert missed_share(passed[None], *start) == pytest.approx([0.0], abs=1e-6)
    passed[1] = 12.0
    assert missed_share(passed[None], *start) == pytest.approx([1.0 / 20.0], rel=1e-5)
    # Who never passes half of the steps leaves there 9 m of 20 to nobody: from 5.5 m to 14.5 m.
    passed[1] = 10.0
    passed[1, : STEPS // 2] = math.nan
    assert missed_share(passed[None], *start) == pytest.approx([0.5 * 9.0 / 20.0], rel=1e-5)
    # Two that have changed places see the same, and who is outside sees nothing of the strip.
    passed = np.tile(np.array([10.0, 0.0, 40.0])[:, None], (1, STEPS))
    assert missed_share(passed[None], *start) == pytest.approx([4.5 / 20.0], rel=1e-5)
    assert np.isnan(missed_share(passed[None], jnp.array([[0.0, 5.0, 0.0]]), start[1]))


def state(true: Any, known: Any, flying: Any) -> Any:
    """Return a state of one fleet at places (n, 2)."""

    def place(values: Any) -> Any:
        north, east = np.asarray(values, float).T
        return SimpleNamespace(position_ned=SimpleNamespace(x=jnp.asarray(north), y=jnp.asarray(east)))

    return SimpleNamespace(
        fleets=[
            SimpleNamespace(
                vehicle=place(true),
                estimate=place(known),
                violation=SimpleNamespace(code=jnp.where(jnp.asarray(flying), 0, 1)),
            )
        ]
    )


def test_errors_are_of_neighbours_and_begin_after_ten_seconds() -> None:
    """Of four in a square, one 3 m north of its place: it is 3 m off both its neighbours, they are off one of two."""
    square = np.array([[0.0, 0.0], [0.0, 5.0], [5.0, 0.0], [5.0, 5.0]])
    off, believed = square.copy(), square.copy()
    off[3, 0] += 3.0
    believed[3, 1] -= 1.0
    world, metrics, flying = SimpleNamespace(time_step=0.02), TeamErrors(), np.ones(4, bool)
    memory = metrics.init(world, state(square, square, flying))
    # What comes before counts for nothing.
    memory = metrics.update(memory, world, state(off + 100.0 * square, square, flying), jnp.int32(499))
    for tick in (500, 501):
        memory = metrics.update(memory, world, state(off, believed, flying), jnp.int32(tick))
    found = metrics.finish(memory, world, None)
    assert found["relative_error_rms_m"] == pytest.approx([0.0, 3.0 / math.sqrt(2.0), 3.0 / math.sqrt(2.0), 3.0])
    # Believed 3 m too far south and 1 m too far west.
    one = math.sqrt(10.0)
    assert found["relative_estimate_rms_m"] == pytest.approx([0.0, one / math.sqrt(2.0), one / math.sqrt(2.0), one])


def test_who_has_stopped_is_nobody_s_neighbour() -> None:
    """The one that is off has stopped."""
    square = np.array([[0.0, 0.0], [0.0, 5.0], [5.0, 0.0], [5.0, 5.0]])
    off = square.copy()
    off[3, 0] += 3.0
    world, metrics = SimpleNamespace(time_step=0.02), TeamErrors()
    memory = metrics.init(world, state(square, square, np.ones(4, bool)))
    memory = metrics.update(memory, world, state(off, off, [True, True, True, False]), jnp.int32(900))
    assert metrics.finish(memory, world, None)["relative_error_rms_m"] == pytest.approx([0.0] * 4)


def test_the_study_has_the_conditions_that_its_page_names() -> None:
    """Three teams, two airs, three receivers, three spacings, 200 seeds; 18 programs."""
    plan = plan_of(load_study("team_errors"))
    assert plan.dims == ("team", "turbulence", "gnss", "spacing", "seed")
    assert plan.shape == (3, 2, 3, 3, 200)
    assert len(plan.groups) == 18
