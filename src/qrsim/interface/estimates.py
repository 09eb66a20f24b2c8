"""A fleet's estimate of itself, as policies and users read it."""

from __future__ import annotations

from qrsim.control import Estimate
from qrsim.interface.arrays import Floats, as_array
from qrsim.world.state import FleetState

FIELDS = ("position_ned", "velocity_ned", "attitude")


class EstimateReading:
    """An estimate of n vehicles as arrays (n, 3).

    Attributes:
        position_ned: [m].
        velocity_ned: over ground [m/s].
        attitude: roll, pitch, yaw [rad].
    """

    def __init__(self, estimate: Estimate, rows: slice):
        self.position_ned: Floats = as_array(estimate.position_ned)[rows]
        self.velocity_ned: Floats = as_array(estimate.velocity_ned)[rows]
        self.attitude: Floats = as_array(estimate.attitude)[rows]

    def __repr__(self) -> str:
        return f"<estimate: {', '.join(FIELDS)}>"


def estimate_of(state: FleetState, rows: slice) -> EstimateReading:
    """Return the estimate of a fleet's own estimator now, else what its controller was fed with last."""
    return EstimateReading(state.estimate if state.belief is None else state.belief.estimate, rows)


def std_of(state: FleetState, rows: slice) -> EstimateReading | None:
    """Return the standard deviations that the estimator reports, None where it reports none."""
    if state.belief is None or state.belief.std is None:
        return None
    return EstimateReading(state.belief.std, rows)
