"""Numbers that vary are put where the World has them: exactly the World that loading the scenario gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from tests.studies.sweep.conftest import planned

from qrsim.errors import ScenarioError
from qrsim.studies.sweep import groups

WINDY = {"world.wind": {"type": "log_shear", "speed_20ft": 1.0, "wind_from_deg": 90.0}}
GUSTY = WINDY | {"world.turbulence": {"type": "dryden"}}
# A range of times is one of whole ticks of 0.02 s.
FAILING = {
    "fleets.pelicans.faults": [
        {"sensor": "barometer", "kind": "drift", "field": "height", "rate": 1.0, "start": 0.1},
        {"sensor": "gnss", "kind": "off", "start": 0.1, "end": 0.5},
    ]
}
TWO = {
    "fleets.pelicans.vehicles": [
        {"position_ned": [0.0, 0.0, -10.0]},
        {"position_ned": [0.0, 9.0, -10.0], "waypoints_ned": [[20.0, 9.0, -10.0]]},
    ]
}


@pytest.mark.parametrize(
    ("setting", "vary"),
    [
        (GUSTY, {"world.wind.speed_20ft": (0.5, 9.0), "world.turbulence.scale": None}),
        (GUSTY, {"world.wind.wind_from_deg": (0.0, 350.0), "world.wind.speed_20ft": (0.5, 9.0)}),
        (TWO, {"fleets.pelicans.vehicles.1.waypoints_ned.0.0": (10.0, 30.0), "fleets.pelicans.vehicle.mass": (1.5, 2)}),
        (TWO, {"fleets.pelicans.vehicles.0.position_ned.2": (-12.0, -9.0), "world.collision_distance": (0.5, 3.0)}),
        (FAILING, {"fleets.pelicans.faults.0.start": (0.113, 0.891), "fleets.pelicans.faults.0.rate": (0.5, 2.0)}),
        (FAILING, {"fleets.pelicans.faults.1.start": (0.0, 0.4), "fleets.pelicans.faults.1.end": (0.5, 0.95)}),
        (TWO | {"world.sky.errors": {"type": "ou"}}, {"world.sky.errors.std": (0.0, 9.0), "ranges": None}),
    ],
)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_worlds_are_those_of_their_scenarios_to_the_bit(
    tmp_path: Path, setting: dict[str, Any], vary: dict[str, Any], precision: str
) -> None:
    ranges = {path: {"low": float(ends[0]), "high": float(ends[1])} for path, ends in vary.items() if ends}
    sampling = {"type": "latin_hypercube", "points": 6}
    plan = planned(
        tmp_path, set={"duration": 1.0} | setting, vary=ranges, sampling=sampling, precision=precision, seeds=1, batch=6
    )
    (group,) = plan.groups.values()
    assert group.places is not None
    batch = plan.batch(0)
    structure, fixed, own, which = group.varied(batch.numbers)
    for i, loaded in enumerate(group.loaded(batch.numbers, precision)):
        shares, owns = iter(fixed), iter(own)
        mine = [next(owns)[i] if varies else next(shares) for varies in which]
        theirs, other = jax.tree.flatten(loaded)
        assert repr(structure) == repr(other)
        for one, another in zip(mine, theirs, strict=True):
            assert np.asarray(one).dtype == np.asarray(another).dtype
            assert np.asarray(one).tobytes() == np.asarray(another).tobytes()


def test_the_places_of_many_numbers_are_found_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Five ranges, two of them alike: in radians, in ticks, in lists and as they are."""
    masses = {"fleets.pelicans.vehicle": {"type": "pelican", "mass": [1.6, 1.6]}}
    ranges = {
        "world.wind.speed_20ft": (0.5, 9.0),
        "world.wind.wind_from_deg": (-30.0, 60.0),
        "fleets.pelicans.faults.1.start": (0.0, 0.4),
        "fleets.pelicans.vehicle.mass.0": (1.5, 2.0),
        "fleets.pelicans.vehicle.mass.1": (1.5, 2.0),
    }
    changes: dict[str, Any] = {
        "set": {"duration": 1.0} | GUSTY | FAILING | TWO | masses,
        "vary": {path: {"low": low, "high": high} for path, (low, high) in ranges.items()},
        "sampling": {"type": "latin_hypercube", "points": 4},
        "seeds": 1,
    }
    monkeypatch.setattr(groups, "MANY", 99)
    (one_by_one,) = planned(tmp_path, **changes).groups.values()
    monkeypatch.setattr(groups, "MANY", 4)
    monkeypatch.setattr(groups, "_place", None)
    (together,) = planned(tmp_path, **changes).groups.values()
    assert together.places is not None
    assert one_by_one.places is not None
    for one, other in zip(one_by_one.places, together.places, strict=True):
        assert (one.path, one.step, one.in_degrees) == (other.path, other.step, other.in_degrees)
        assert [number for number, _ in one.parts] == [number for number, _ in other.parts]
        for (_, mine), (_, theirs) in zip(one.parts, other.parts, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    assert {place.path: (place.step, place.in_degrees) for place in together.places} == {
        "world.wind.speed_20ft": (0.0, False),
        "world.wind.wind_from_deg": (0.0, True),
        "fleets.pelicans.faults.1.start": (0.02, False),
        "fleets.pelicans.vehicle.mass.0": (0.0, False),
        "fleets.pelicans.vehicle.mass.1": (0.0, False),
    }


def test_times_of_faults_are_rounded_down_to_ticks(tmp_path: Path) -> None:
    path, sampling = "fleets.pelicans.faults.0.start", {"type": "latin_hypercube", "points": 100}
    changes: dict[str, Any] = {"set": {"duration": 1.0} | FAILING, "seeds": 1, "batch": 100}
    plan = planned(tmp_path, vary={path: {"low": 0.113, "high": 0.891}}, sampling=sampling, **changes)
    times = plan.batch(0).numbers[path]
    np.testing.assert_allclose(times / 0.02, np.round(times / 0.02), atol=1e-6)
    # Between the ends, 0.10 and 0.88 s, are 39 ticks.
    assert (times.min(), times.max(), len(set(times.tolist()))) == (0.1, 0.86, 39)
    spaced = planned(tmp_path, vary={path: {"low": 0.1, "high": 0.9, "count": 4}}, **changes)
    np.testing.assert_allclose(spaced.batch(0).numbers[path], [0.1, 0.36, 0.62, 0.9])
    assert spaced.groups[()].places is not None
    with pytest.raises(ScenarioError, match=r"0\.113 s is not a multiple of the time step 0\.02 s"):
        planned(tmp_path, vary={path: {"values": [0.113, 0.5]}}, **changes)


def test_what_is_not_simply_a_number_of_the_world_is_loaded(tmp_path: Path) -> None:
    # The site moves the orbits of all satellites.
    plan = planned(tmp_path, vary={"site.latitude_deg": {"values": [0.0, 40.0]}})
    assert plan.groups[()].places is None


def test_what_changes_the_structure_makes_groups(tmp_path: Path) -> None:
    vary = {
        "fleets.pelicans.vehicles.count": {"values": [1, 2], "name": "vehicles"},
        "world.wind": {"values": ["calm", {"type": "log_shear", "speed_20ft": 2.0, "wind_from_deg": 0.0}]},
        "duration": {"values": [1.0, 2.0]},
        "fleets.pelicans.vehicle.mass": {"values": [1.5, 1.6]},
    }
    plan = planned(tmp_path, set=TWO, vary=vary)
    assert plan.structural == ("fleets.pelicans.vehicles.count", "world.wind", "duration")
    found = {key: (group.vehicles, group.ticks, type(group.world.wind).__name__) for key, group in plan.groups.items()}
    assert len(found) == 8
    assert found[0, 0, 0] == (1, 50, "Calm")
    assert found[1, 1, 1] == (2, 100, "LogShear")
