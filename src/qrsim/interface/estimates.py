"""A fleet's estimate of itself, as policies and users read it."""

from __future__ import annotations

from qrsim.control import Estimate
from qrsim.core.arrays import Floats
from qrsim.core.tables import Table, Tabled, cells_of, columns_of
from qrsim.interface.arrays import as_array
from qrsim.world.state import FleetState

FIELDS = {"position_ned": "m", "velocity_ned": "m/s", "attitude": "rad"}


class EstimateReading(Tabled):
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

    def _cells(self, columns: int) -> list[tuple[str, ...]]:
        """Return a row of texts for each field of the estimate: name, unit, and up to ``columns`` vehicles' numbers."""
        return [(name, unit, *cells_of(getattr(self, name), columns)) for name, unit in FIELDS.items()]

    def _table(self) -> Table:
        """Return the estimate as a table for display: a row for each field, a column for each vehicle."""
        columns = columns_of([f"vehicle {row}" for row in range(self.position_ned.shape[0])])
        return Table("estimate", ("field", "unit", *columns), self._cells(len(columns)))


def estimate_of(state: FleetState, rows: slice) -> EstimateReading:
    """Return the present estimate of vehicles ``rows``: the estimator's, or the last one that the controller used."""
    return EstimateReading(state.estimate if state.belief is None else state.belief.estimate, rows)


def std_of(state: FleetState, rows: slice) -> EstimateReading | None:
    """Return the standard deviations that a fleet's estimator reports for the vehicles ``rows``; None if it reports
    none."""
    if state.belief is None or state.belief.std is None:
        return None
    return EstimateReading(state.belief.std, rows)
