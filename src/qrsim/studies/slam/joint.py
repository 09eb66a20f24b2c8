"""The graphs of several vehicles as one: shared landmarks, ranges between vehicles, and what fixes have in common.

The unknowns of all vehicles at one time are one block of the chain, so that it stays block-tridiagonal: the positions
of all (3 N), then each vehicle's other unknowns, then, where modelled, the common error of all fixes, north and east.
Factors beside those of each vehicle (``qrsim.studies.slam.graph``), in units of their own standard deviation:

- between  (|p_i,k - p_j,k| - d_ijk) / std, for each pair of vehicles that ranged to each other at a state
- fix      (p_k + b_k + c_k - z_k) / std, with the common error c_k
- common   c_k+1 = exp(-dt/tau) c_k + noise, and c_0 / s
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from qrsim.core.tree import record_of, replace
from qrsim.studies.slam.between import Between, distances
from qrsim.studies.slam.flight import Floats
from qrsim.studies.slam.graph import Graph, Normal, cost, linearise

# The least distance [m] whose direction is taken for that of a range.
NEAREST = 1e-9


@dataclass(frozen=True)
class Common:
    """An Ornstein-Uhlenbeck error that the fixes of all vehicles share, north and east.

    Attributes:
        std: standard deviation per axis [m].
        decay: exp(-dt/tau) over one state.
    """

    std: float
    decay: float

    @property
    def weights(self) -> tuple[float, float]:
        """Inverse standard deviations [1/m] of the first common GNSS error, and of its noise in one interval."""
        return 1.0 / self.std, 1.0 / (self.std * (1.0 - self.decay**2) ** 0.5)


@dataclass(frozen=True)
class JointGraph:
    """A problem of N vehicles with states at the same times.

    Attributes:
        graphs: of each vehicle alone, all of one size D, with the same landmarks.
        between: ranges between them.
        common: error that their fixes share; None: they share none.
    """

    graphs: tuple[Graph, ...]
    between: Between
    common: Common | None = None

    @property
    def size(self) -> int:
        """Number of unknowns at one time: all vehicles' states, and the common GNSS error."""
        return len(self.graphs) * self.graphs[0].size + 2 * (self.common is not None)

    def columns(self, vehicle: int) -> npt.NDArray[np.int64]:
        """Return the indices (D,) of a vehicle's unknowns among those of one time."""
        rest = self.graphs[0].size - 3
        places = 3 * vehicle + np.arange(3)
        others = 3 * len(self.graphs) + rest * vehicle + np.arange(rest)
        return np.concatenate([places, others])

    def joined(self, states: list[Floats]) -> Floats:
        """Join the vehicles' states, each (T + 1, D), to unknowns (T + 1, size) with a common GNSS error of 0."""
        x = np.zeros((len(states[0]), self.size))
        for vehicle, values in enumerate(states):
            x[:, self.columns(vehicle)] = values
        return x

    def split(self, x: Floats) -> tuple[list[Floats], Floats | None]:
        """Split unknowns (T + 1, size) into the vehicles' states and the common GNSS error (T + 1, 2) (None: none)."""
        states = [x[:, self.columns(vehicle)] for vehicle in range(len(self.graphs))]
        return states, None if self.common is None else x[:, -2:]

    def positions(self, x: Floats) -> Floats:
        """Return the positions (N, T + 1, 3) [m] of N vehicles in unknowns x (T + 1, size)."""
        return x[:, : 3 * len(self.graphs)].reshape(len(x), -1, 3).transpose(1, 0, 2)

    def _alone(self, x: Floats) -> list[tuple[Graph, Floats]]:
        """Return each vehicle's (graph, states), with the common GNSS error subtracted from its fixes."""
        states, common = self.split(x)
        if common is None:
            return list(zip(self.graphs, states, strict=True))
        shift = jnp.asarray(common)
        return [(replace(g, fixes=g.fixes - shift), own) for g, own in zip(self.graphs, states, strict=True)]

    def _range_residuals(self, x: Floats) -> tuple[Floats, Floats]:
        """Return weights [1/m] and residuals (T + 1, P) of ranges between P pairs; 0 for missing ranges."""
        seen = np.isfinite(self.between.ranges)
        weight = np.where(seen, np.sqrt(self.between.counts) / self.between.std, 0.0)
        apart = distances(self.positions(x), self.between.pairs) - np.where(seen, self.between.ranges, 0.0)
        return weight, weight * apart

    def _common_residuals(self, x: Floats) -> tuple[Floats, Floats]:
        """Return residuals of the common GNSS error: of its first value (2,), of its changes (T, 2)."""
        if self.common is None:
            return np.zeros(2), np.zeros((len(x) - 1, 2))
        first, following = self.common.weights
        error = x[:, -2:]
        return first * error[0], following * (error[1:] - self.common.decay * error[:-1])

    def cost(self, x: Floats, landmarks: Floats) -> float:
        """Return half the sum of all squared residuals at unknowns x (T + 1, size) and landmarks (L, 3)."""
        alone = sum(float(cost(g, jnp.asarray(own), jnp.asarray(landmarks))) for g, own in self._alone(x))
        return alone + 0.5 * sum(
            float(np.sum(part**2)) for part in (self._range_residuals(x)[1], *self._common_residuals(x))
        )

    def linearise(self, x: Floats, landmarks: Floats) -> Normal:
        """Return the normal equations at unknowns x (T + 1, size) and landmarks (L, 3)."""
        count, size, places = len(x), self.size, 3 * len(self.graphs)
        marks = len(landmarks)
        diagonal, below = np.zeros((count, size, size)), np.zeros((count - 1, size, size))
        border, corner = np.zeros((count, places, marks, 3)), np.zeros((marks, 3, 3))
        gradient, of_landmarks = np.zeros((count, size)), np.zeros((marks, 3))
        value = 0.0
        for vehicle, (graph, own) in enumerate(self._alone(x)):
            part = linearise(graph, jnp.asarray(own), jnp.asarray(landmarks))
            columns = self.columns(vehicle)
            rows = columns[:, None]
            diagonal[:, rows, columns] = part.diagonal
            below[:, rows, columns] = part.below
            border[:, 3 * vehicle : 3 * vehicle + 3] = part.border
            # Each adds 1 where a landmark has too few ranges: such a landmark stays where it is all the same.
            corner += np.asarray(part.corner)
            gradient[:, columns] = part.gradient
            of_landmarks += np.asarray(part.gradient_landmarks)
            value += float(part.cost)
            if self.common is not None:
                self._add_fixes(graph, columns, own, diagonal, gradient)
        value += self._add_between(x, diagonal, gradient)
        if self.common is not None:
            value += self._add_common(x, self.common, diagonal, below, gradient)
        return record_of(Normal, value, diagonal, below, border, corner, gradient, of_landmarks)

    def _add_fixes(
        self, graph: Graph, columns: npt.NDArray[np.int64], own: Floats, diagonal: Floats, gradient: Floats
    ) -> None:
        """Add the fixes' terms in the common GNSS error to ``diagonal`` and ``gradient``, in place."""
        weight = np.asarray(graph.fix_weight) ** 2
        at = self.size - 2 + np.arange(2)
        by = [columns[:2]] + ([columns[graph.vehicle_size :]] if graph.bias else [])
        for those in by:
            diagonal[:, at, those] += weight[:, None]
            diagonal[:, those, at] += weight[:, None]
        diagonal[:, at, at] += weight[:, None]
        believed = own[:, :2] + (own[:, graph.vehicle_size :] if graph.bias else 0.0)
        gradient[:, -2:] += weight[:, None] * (believed - np.asarray(graph.fixes))

    def _add_between(self, x: Floats, diagonal: Floats, gradient: Floats) -> float:
        """Add the terms of ranges between vehicles to ``diagonal`` and ``gradient`` in place; return their cost."""
        weight, residual = self._range_residuals(x)
        position = self.positions(x)
        for p, (one, other) in enumerate(self.between.pairs):
            apart = position[one] - position[other]
            length = np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), NEAREST)
            row = weight[:, p, None] * apart / length
            block = row[:, :, None] * row[:, None, :]
            first, second = slice(3 * one, 3 * one + 3), slice(3 * other, 3 * other + 3)
            diagonal[:, first, first] += block
            diagonal[:, second, second] += block
            diagonal[:, first, second] -= block
            diagonal[:, second, first] -= block
            gradient[:, first] += row * residual[:, p, None]
            gradient[:, second] -= row * residual[:, p, None]
        return 0.5 * float(np.sum(residual**2))

    def _add_common(self, x: Floats, common: Common, diagonal: Floats, below: Floats, gradient: Floats) -> float:
        """Add prior and changes of the common GNSS error to the normal equations in place; return their cost."""
        first, following = common.weights
        start, steps = self._common_residuals(x)
        at = self.size - 2 + np.arange(2)
        diagonal[0, at, at] += first**2
        diagonal[:-1, at, at] += (following * common.decay) ** 2
        diagonal[1:, at, at] += following**2
        below[:, at, at] -= following**2 * common.decay
        gradient[0, -2:] += first * start
        gradient[:-1, -2:] -= following * common.decay * steps
        gradient[1:, -2:] += following * steps
        return 0.5 * float(np.sum(start**2) + np.sum(steps**2))
