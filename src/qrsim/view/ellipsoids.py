"""Ellipsoids that hold the true position with 95 %, by the standard deviations that an estimator reports."""

from __future__ import annotations

import math

import numpy as np

from qrsim.control.contracts import Estimator
from qrsim.view import shapes
from qrsim.view.frame import Frame
from qrsim.view.layers import Layer, Stage
from qrsim.world.state import Fleet, World

UNCERTAINTY = "estimate, 95 %"
# Root of the 95 % quantile of chi squared with three degrees of freedom.
SIGMAS = math.sqrt(7.814727903251178)


class Ellipsoids(Layer):
    """An ellipsoid at the estimated position of each vehicle, true to scale.

    Its axes point north, east and down: logs have standard deviations, not covariances.
    """

    title = UNCERTAINTY
    every, beside = 3.0, True
    most = 20

    def begin(self) -> None:
        """Add one ball per vehicle to the scene, to show the uncertainty of its estimated position."""
        self._handle = self.batch("balls", shapes.ball(), self.stage.colours, opacity=0.3)

    def draw(self, frame: Frame) -> None:
        """Move each ball to the estimated position, scaled by its standard deviations; hidden without an estimate."""
        if frame.details is None:
            return
        found = frame.details()
        known = np.isfinite(found.believed_ned + found.std_ned).all(axis=1) & frame.valid
        self._handle.batched_positions = np.where(known[:, None], found.believed_ned, 0.0).astype(np.float32)
        self._handle.batched_scales = np.where(known[:, None], SIGMAS * found.std_ned, 0.0).astype(np.float32)


def ellipsoid_layers(stage: Stage, world: World) -> list[Layer]:
    """Return a list with the layer of uncertainty ellipsoids, [] if no estimator reports standard deviations."""
    return [Ellipsoids(stage)] if any(map(_states_std, world.fleets)) else []


def _states_std(fleet: Fleet) -> bool:
    """Return whether the estimator of a fleet reports standard deviations."""
    own = fleet.own_estimator
    return own is not None and type(own).std is not Estimator.std
