"""The references of altitudes of plans: the ground of a scenario, built when needed, and mean sea level."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from qrsim.core.tree import record_of
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Ground, down_at
from qrsim.scenarios import build
from qrsim.scenarios.plans.heights import Floats, GroundDown
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.site_schema import SiteSpec


class PlanGround:
    """The ground.

    Args:
        scenario: with its site in numbers and its area in NED.
    """

    def __init__(self, scenario: ScenarioSpec):
        self._scenario = scenario

    @property
    def relief(self) -> bool:
        """True if the scenario's ground is not level."""
        return bool(self._scenario.world.ground.type != "flat")

    @cached_property
    def _ground(self) -> Ground | None:
        """The scenario's ground model, built at first use; None if it cannot be built."""
        return build.ground_if_any(self._scenario)

    def down(self, north: npt.ArrayLike, east: npt.ArrayLike) -> Floats:
        """Return the ground's z coordinate [m, down] at north and east (...) [m]; 0 if there is no ground model."""
        if self._ground is None:
            return np.zeros(np.broadcast(north, east).shape)
        return ground_down(self._ground)(north, east)


def ground_down(ground: Ground) -> GroundDown:
    """Return a function that maps north and east (...) [m] to the ground's z coordinate (...) [m, down]."""

    def down(north: npt.ArrayLike, east: npt.ArrayLike) -> Floats:
        """Return the ground's z coordinate (...) [m, down] at north and east (...) [m]."""
        places = np.broadcast_arrays(np.asarray(north, np.float64), np.asarray(east, np.float64), 0.0)
        found = down_at(ground, record_of(Vec3, *map(np.atleast_1d, places)))
        # Added to zero, because a ground at z = 0 may be at -0.
        return np.asarray(found, np.float64).reshape(places[0].shape) + 0.0

    return down


def amsl_of(given: SiteSpec, place: SiteSpec) -> float | None:
    """Return a site's altitude above mean sea level [m], None if neither site nor plan gives a height.

    Args:
        given: as the scenario has it.
        place: the same in numbers, with the altitude of its plan.
    """
    if place.height_amsl is not None:
        return place.height_amsl
    if "height" not in given.model_fields_set:
        return None
    return place.height - place.undulation
