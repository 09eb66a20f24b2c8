"""Plans: every episode once, values by their numbers, nothing made before it is asked for."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.studies.sweep.conftest import planned, write

from qrsim.errors import ScenarioError
from qrsim.studies.sweep.axes import Axis
from qrsim.studies.sweep.prepare import plan_of, plan_of_numbers
from qrsim.studies.sweep.sampling import Sample
from qrsim.studies.sweep.study import SamplingSpec, load_study

MASS = "fleets.pelicans.vehicle.mass"
WIND = "world.wind.speed_20ft"
RANGES = {WIND: {"low": 0.0, "high": 5.0}, MASS: {"low": 1.5, "high": 1.8}}


def sampled(kind: str, points: int, **more: Any) -> dict[str, Any]:
    return {"vary": RANGES, "sampling": {"type": kind, "points": points, "seed": 3}, **more}


@pytest.mark.parametrize(
    "changes",
    [
        {"batch": 1},
        {"batch": 7},
        {"batch": 11},
        {"batch": None},
        sampled("latin_hypercube", 13, batch=17),
        {
            "vary": {"fleets.pelicans.controller.feed": {"values": ["truth", "measurements"]}, **RANGES},
            "sampling": {"type": "sobol", "points": 8},
            "batch": 12,
        },
        {"vary": {WIND: {"values": [0.0, 1.0, 2.0]}, MASS: {"values": [1.5, 1.6, 1.7]}}, "sampling": {"type": "list"}},
    ],
)
def test_every_episode_is_in_one_batch_with_the_values_of_its_place(tmp_path: Path, changes: dict[str, Any]) -> None:
    plan = planned(tmp_path, **changes)
    seen = np.zeros(plan.shape, int)
    places = np.arange(plan.episodes).reshape(plan.shape)
    for index in range(plan.batches):
        batch = plan.batch(index)
        seen[batch.region] += 1
        for i, place in enumerate(places[batch.region].ravel().tolist()):
            position = tuple(int(at) for at in np.unravel_index(place, plan.shape))
            values = plan.values_at(position)
            assert {path: column[i] for path, column in batch.numbers.items()} == {
                path: value for path, value in values.items() if path in batch.numbers
            }
            chosen = [
                axis.values[at]
                for axis, at in zip(
                    [axis for axis in plan.axes if axis.path in plan.structural], batch.group, strict=True
                )
            ]  # type: ignore[index]
            assert chosen == [values[path] for path in plan.structural]
            assert batch.seeds[i] == position[-1]
    assert (seen == 1).all()


@pytest.mark.parametrize("kind", ["latin_hypercube", "sobol", "saltelli"])
def test_a_sample_is_the_same_however_it_is_cut(kind: Any) -> None:
    sample = Sample(SamplingSpec(type=kind, points=16, seed=4), 3)
    whole = sample.rows(0, sample.size)
    assert whole.shape == (16 * 5 if kind == "saltelli" else 16, 3)
    parts = [sample.rows(start, min(start + 7, sample.size)) for start in range(0, sample.size, 7)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert not np.array_equal(Sample(SamplingSpec(type=kind, points=16, seed=5), 3).rows(0, 16), whole[:16])


def test_a_saltelli_sample_has_the_order_that_salib_expects() -> None:
    points = Sample(SamplingSpec(type="saltelli", points=8, seed=1), 3).rows(0, 40).reshape(8, 5, 3)
    first, last = points[:, 0], points[:, -1]
    for column in range(3):
        mixed = points[:, column + 1]
        np.testing.assert_array_equal(mixed[:, column], last[:, column])
        others = [other for other in range(3) if other != column]
        np.testing.assert_array_equal(mixed[:, others], first[:, others])


def test_a_logarithmic_range_is_even_in_its_logarithm(tmp_path: Path) -> None:
    vary = {MASS: {"low": 1.0, "high": 4.0, "scale": "log"}}
    plan = planned(tmp_path, vary=vary, sampling={"type": "latin_hypercube", "points": 64})
    values = plan.rows(0, 64)[MASS]
    counts, _ = np.histogram(np.log(values), np.linspace(0.0, np.log(4.0), 9))
    assert counts.tolist() == [8] * 8


@pytest.mark.parametrize("kind", ["sobol", "grid"])
def test_a_million_points_are_planned_without_being_listed(tmp_path: Path, kind: str) -> None:
    counted = {path: {**item, "count": 1000} for path, item in RANGES.items()}
    changes = sampled("sobol", 2**20) if kind == "sobol" else {"vary": counted}
    plan = planned(tmp_path, **changes, seeds=1, batch=4096)
    tracemalloc.start()
    assert plan.points >= 10**6
    for index in (0, plan.batches // 2, plan.batches - 1):
        plan.batch(index)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # A number of every point would take 8 MB.
    assert peak < 4e6


FIXED = "small: vary.world.wind.speed: the gust stays at 10 m/s"
FORECAST = {"type": "log_shear", "speed": 6.0, "gust": 10.0, "wind_from_deg": 0.0}


@pytest.mark.parametrize(
    ("gust", "vary", "words"),
    [
        ({}, {"world.wind.speed": {"values": [0.0, 9.0]}}, [FIXED]),
        ({}, {"world.wind.speed": {"low": 0.0, "high": 9.0, "count": 2}}, [FIXED]),
        ({}, {"air": {"conditions": {"calm": {"world.wind.speed": 1.0}}}}, [FIXED]),
        ({}, {"air": {"conditions": {"calm": {"world.wind.speed": 1.0, "world.wind.gust": 2.0}}}}, []),
        ({"gust": None, "gust_factor": 1.6}, {"world.wind.speed": {"values": [0.0, 9.0]}}, []),
        ({}, {"world.wind.speed_20ft": {"values": [0.0, 9.0]}}, []),
    ],
)
def test_a_gust_that_stays_while_the_speed_varies(
    tmp_path: Path, recwarn: Any, gust: dict[str, Any], vary: dict[str, Any], words: list[str]
) -> None:
    wind = {name: value for name, value in {**FORECAST, **gust}.items() if value is not None}
    planned(tmp_path, set={"world.wind": wind}, vary=vary)
    assert [str(warning.message).partition(",")[0] for warning in recwarn] == words


def test_paired_points_have_a_seed_each(tmp_path: Path) -> None:
    sampling = {"type": "latin_hypercube", "points": 5, "paired": True}
    plan = planned(tmp_path, vary=RANGES, sampling=sampling, seeds=1, first_seed=40, batch=2)
    assert [plan.batch(index).seeds.tolist() for index in range(plan.batches)] == [[40, 41], [42, 43], [44]]
    with pytest.raises(ScenarioError, match="paired points have one seed each; give seeds: 1"):
        planned(tmp_path, vary=RANGES, sampling=sampling, seeds=2)


def test_a_normal_range_has_its_ends_three_deviations_from_the_middle() -> None:
    axis = Axis("world.wind.speed_20ft", "wind", "m/s", None, 4.0, 10.0, "normal")
    # Between -3 and 3 deviations lie 0.9973 of a normal number; one deviation above the middle is at
    # (0.841345 - 0.001350)/0.997300 = 0.842269 of them.
    found = axis.scaled(np.array([0.0, 0.5, 0.842269, 0.999999999]))
    np.testing.assert_allclose(found, [4.0, 7.0, 8.0, 10.0], atol=1e-4)


def test_tracks_have_a_record_for_each_interval(tmp_path: Path) -> None:
    plan = planned(tmp_path, track=0.1)
    (group,) = plan.groups.values()
    assert plan.track == (1 + round(group.ticks * group.time_step / 0.1), group.vehicles, 4)
    assert planned(tmp_path).track == ()


def test_a_plan_of_numbers_flies_the_same_as_a_plan(tmp_path: Path) -> None:
    file = write(tmp_path, **sampled("latin_hypercube", 8))
    one, other = (made(load_study(str(file))) for made in (plan_of, plan_of_numbers))
    assert one.shape == other.shape
    assert [place.path for place in other.groups[()].places or ()] == [WIND, MASS]
    for path, values in one.batch(0).numbers.items():
        np.testing.assert_array_equal(values, other.batch(0).numbers[path])
    wrong = write(tmp_path, vary={WIND: {"low": 0.0, "high": 60.0}}, sampling={"type": "sobol", "points": 8})
    with pytest.raises(ScenarioError, match=r"speed_20ft: 60\.0 is out of range"):
        plan_of_numbers(load_study(str(wrong)))
