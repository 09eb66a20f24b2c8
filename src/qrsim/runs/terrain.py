"""The ground of a run, built from the scenario that the run keeps."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError, warn_user
from qrsim.runs.reader import Run

if TYPE_CHECKING:
    from qrsim.models.scene.contracts import Ground


class Terrain:
    """Heights of the ground; a level plane if the ground of the run can no longer be built.

    Attributes:
        level: whether it is a level plane.
    """

    def __init__(self, run: Run):
        content = run.scenario if isinstance(run.scenario, dict) else {}
        world = content.get("world")
        ground = world.get("ground") if isinstance(world, dict) else None
        kind = ground.get("type", "flat") if isinstance(ground, dict) else "flat"
        self._ground: Ground | None = None
        self._down = 0.0
        if kind == "flat":
            height = ground.get("height", 0.0) if isinstance(ground, dict) else 0.0
            self._down = -float(height) if isinstance(height, int | float) else 0.0
        else:
            self._ground = _built(run)
        self.level = self._ground is None

    def down(self, north: Floats, east: Floats) -> Floats:
        """Return the ground's z coordinate [m, down] at north and east [m], of any shape; NaN for NaN places."""
        if self._ground is None:
            return np.full(np.shape(north), self._down)
        from qrsim.core.vectors import Vec3
        from qrsim.models.scene.contracts import down_at

        flat = [np.nan_to_num(np.ravel(axis)).astype(np.float32) for axis in (north, east, 0.0 * east)]
        found = np.asarray(down_at(self._ground, Vec3(*flat)), np.float64)
        return np.where(np.isfinite(north), found.reshape(np.shape(north)), np.nan)


@lru_cache(maxsize=2)
def terrain_of(run: Run) -> Terrain:
    """Return the terrain of a run; built once and shared by the run's tables and figures."""
    return Terrain(run)


def _built(run: Run) -> Ground | None:
    """Build the ground of a run's scenario; None, with a warning, if that is no longer possible."""
    from qrsim.scenarios.build import ground_of

    try:
        return ground_of(run.built().spec)
    except (QrsimError, OSError) as error:
        warn_user(f"{run.folder}: the ground is drawn level, because it cannot be built: {error}")
        return None
