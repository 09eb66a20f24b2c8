"""The ground of a scenario for its plans, built when the first of them needs it."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from qrsim.core.tree import record_of
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import down_at
from qrsim.scenarios import build
from qrsim.scenarios.plans.heights import Floats
from qrsim.scenarios.schema import ScenarioSpec


class PlanGround:
    """The ground.

    Args:
        scenario: with its site in numbers and its area in NED.
    """

    def __init__(self, scenario: ScenarioSpec):
        self._scenario = scenario

    @property
    def relief(self) -> bool:
        """True where its height differs from place to place."""
        return bool(self._scenario.world.ground.type != "flat")

    @cached_property
    def _ground(self) -> Any:
        return build.ground_if_any(self._scenario)

    def down(self, north: npt.ArrayLike, east: npt.ArrayLike) -> Floats:
        """Return down coordinates (...) [m] of places (...) [m]; of 0 where the ground cannot be built."""
        places = np.broadcast_arrays(np.asarray(north, np.float64), np.asarray(east, np.float64), 0.0)
        if self._ground is None:
            return np.zeros_like(places[0])
        found = down_at(self._ground, record_of(Vec3, *map(np.atleast_1d, places)))
        # Added to zero, because a ground at z = 0 may be at -0.
        return np.asarray(found, np.float64).reshape(places[0].shape) + 0.0
