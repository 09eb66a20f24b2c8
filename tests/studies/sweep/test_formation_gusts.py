"""The shipped study of a formation, in small: one air keeps neighbours together that gusts of their own drive apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.simulation.rollout import rollout
from qrsim.studies.sweep.study import load_study


@pytest.mark.long
def test_one_air_keeps_a_formation_together() -> None:
    """After a minute at 4 m/s, 6 worlds of 30 s: more common motion, and a third of the motion of neighbours."""
    study = load_study("formation_gusts")
    apart, common, near = {}, {}, {}
    for kind in ("dryden", "dryden_field"):
        content = {**study.content, "name": kind, "world": {**study.content["world"], "turbulence": {"type": kind}}}
        world = qrsim.load_scenario(content, quiet=True).world()

        def look(state: Any) -> Any:
            fleet = state.fleets[0]
            return fleet.vehicle.position_ned.stack(), fleet.gust_ned.stack()

        found = rollout(world, ticks=4500, worlds=6, seed=1, record=look, record_every=25)
        place, gust = (np.asarray(part, float)[:, found.record_ticks >= 3000] for part in found.recorded)
        place = place.reshape(*place.shape[:2], 5, 4, 3)
        gust = gust.reshape(place.shape)
        apart[kind] = float(np.std(np.diff(place, axis=2), axis=1).mean())
        common[kind] = float(np.std(place.mean(axis=(2, 3)), axis=1).mean())
        near[kind] = float(np.mean(gust[:, :, 1:, :, 0] * gust[:, :, :-1, :, 0]) / np.mean(gust[..., 0] ** 2))
    assert apart["dryden_field"] < apart["dryden"] / 3.0
    assert common["dryden_field"] > 2.0 * common["dryden"]
    # exp(-5/94) at 15 m; over 6 worlds of 30 s.
    assert near["dryden_field"] == pytest.approx(0.948, abs=0.03)
    assert abs(near["dryden"]) < 0.15
