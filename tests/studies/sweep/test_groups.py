"""Numbers that vary are put where the World has them: exactly the World that loading the scenario gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from tests.studies.sweep.conftest import planned

WINDY = {"world.wind": {"type": "log_shear", "speed_20ft": 1.0, "wind_from_deg": 90.0}}
GUSTY = WINDY | {"world.turbulence": {"type": "dryden"}}
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
