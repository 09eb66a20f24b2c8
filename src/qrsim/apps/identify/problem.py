"""Multiple shooting: a log cut into windows, each flown from a start of its own that is estimated with the rest.

The start of a window matters to that window alone. It is therefore found inside (a few Gauss-Newton steps, weighted by
the same robust loss), and what is left to the outer solver are the constants and the few nuisances of each log. At
the inner optimum the derivative of the outer sum is exact although the starts move with the constants.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.apps.identify.constants import CHANNELS, TILT_COMMANDS, channels_of, nuisances_in
from qrsim.apps.identify.simulate import PLACE, linearised, predict
from qrsim.core.tree import cast
from qrsim.errors import UsageError
from qrsim.flight_logs import FlightLog
from qrsim.flight_logs.signals import Floats
from qrsim.models.vehicles.quadrotor import Quadrotor

# Used where a log has none: no ceiling of the thrust is met.
FULL_BATTERY_V = 12.0
# A start that moves by less than this many standard deviations changes the sum by nothing that matters.
INNER_STEPS, INNER_TOLERANCE = 2, 0.1
# A piece between gaps that is shorter is left out.
SHORTEST_ROWS = 25
# The robust loss grows linearly beyond so many standard deviations.
ROBUST_AT = 3.0


@dataclass(frozen=True)
class Piece:
    """Rows of a log that belong together: the part to fit, or the part to score.

    Attributes:
        log: where they are from.
        channels: measured signals.
        nuisances: estimated for this log.
        commands: (T, 5) SI commands of the log from its beginning to the end of the part, gaps held.
        measured: (T, C) measured channels of the whole log.
        windows: (W, n) rows of each window; those beyond its end repeat its last.
        used: (W, n) whether a row counts.
    """

    log: FlightLog
    channels: tuple[str, ...]
    nuisances: tuple[str, ...]
    commands: Floats
    measured: Floats
    windows: np.ndarray[Any, Any]
    used: np.ndarray[Any, Any]

    @property
    def places(self) -> tuple[int, ...]:
        """Of the measured channels among all."""
        return tuple(PLACE[name] for name in self.channels)

    @property
    def recorded(self) -> Floats:
        """The measured channels in each window, (W, n, C)."""
        return self.measured[self.windows]

    def starts(self) -> Floats:
        """Return (n, 10) channels at the first row of each window, as measured; 0 for what is not."""
        starts = np.zeros((self.windows.shape[1], len(CHANNELS)))
        starts[:, list(self.places)] = self.measured[self.windows[0]]
        return starts


def cut(log: FlightLog, horizon: float, first: float = 0.0, last: float = 1.0, whole: bool = False) -> Piece:
    """Cut a share of a log's rows, from ``first`` to ``last``, into windows of ``horizon`` [s].

    Args:
        log: what was read.
        horizon: length of a window [s]; at a gap it ends early.
        first, last: shares of the rows.
        whole: leave out windows that are shorter than the horizon.

    Raises:
        UsageError: no window is left.
    """
    channels = channels_of(log)
    commands, missing = _commands(log)
    measured = np.stack([log.signals[name] for name in channels], axis=1)
    good = np.isfinite(measured).all(axis=1) & ~missing
    good[: round(first * len(good))] = False
    good[round(last * len(good)) :] = False
    runs = _runs(good)
    longest = max((end - begin for begin, end in runs), default=0)
    length = max(2, round(min(horizon / log.dt, longest)))
    windows, used = [], []
    for begin, end in runs:
        for at in range(begin, end, length):
            rows = np.arange(at, at + length)
            if end - at >= (length if whole else min(length, SHORTEST_ROWS)):
                windows.append(np.minimum(rows, end - 1))
                used.append(rows < end)
    if not windows:
        raise UsageError(
            f"{log.source}: too short: no piece of {min(length, SHORTEST_ROWS) * log.dt:g} s without a gap among rows"
            f" {round(first * len(good))} to {round(last * len(good))} of {len(good)}"
        )
    # What comes later has no effect on these rows.
    commands = commands[: round(last * len(good))]
    return Piece(log, channels, nuisances_in(channels), commands, measured, np.stack(windows, 1), np.stack(used, 1))


def _commands(log: FlightLog) -> tuple[Floats, np.ndarray[Any, Any]]:
    """Return (T, 5) commands in the order of Command, gaps held, and which rows have a gap."""
    rows = len(log.time)
    columns, missing = [], np.zeros(rows, bool)
    names = (TILT_COMMANDS[1], TILT_COMMANDS[0], "throttle", TILT_COMMANDS[2], "battery")
    for name in names:
        default = FULL_BATTERY_V if name == "battery" else 0.0
        values = log.signals.get(name, np.full(rows, default))
        bad = ~np.isfinite(values)
        missing |= bad
        last_good = np.maximum.accumulate(np.where(bad, 0, np.arange(rows)))
        columns.append(np.nan_to_num(values[last_good], nan=default))
    return np.stack(columns, axis=1), missing


def _runs(good: np.ndarray[Any, Any]) -> list[tuple[int, int]]:
    """Return (begin, end) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


class Shooting:
    """One piece with the starts of its windows, which are remembered from one evaluation to the next."""

    def __init__(self, piece: Piece, vehicle: Quadrotor, robust: bool = True):
        self.piece = piece
        self.vehicle = cast(vehicle, np.float64)
        self.robust = robust
        self.starts = piece.starts()
        self._follow: tuple[Floats, Floats] | None = None

    def residuals(
        self, values: Mapping[str, float], noise: Mapping[str, float], free_starts: bool = True
    ) -> tuple[Floats, Floats]:
        """Return residuals and their derivatives by ``values``, with the starts at their optimum.

        Args:
            values: of the unknowns by name.
            noise: standard deviation of each channel, which residuals are divided by.
            free_starts: estimate the starts; else they stay.

        Returns:
            (W, n, C) and (W, n, C, K); 0 where a row does not count.
        """
        scale = np.array([noise[name] for name in self.piece.channels])
        counts = self.piece.used[:, :, None] / scale
        at = np.array(list(values.values()))
        if free_starts and self._follow is not None and len(self._follow[0]) == len(at):
            self.starts[:, list(self.piece.places)] += self._follow[1] @ (at - self._follow[0])
        for step in range(INNER_STEPS):
            with jax.enable_x64(True):
                found, by_value, by_start = (np.asarray(part) for part in linearised(*self._arguments(values)))
            if not (np.isfinite(found).all() and np.isfinite(by_value).all() and np.isfinite(by_start).all()):
                # The solver tried constants that no vehicle has; it comes back from there.
                self.starts, self._follow = self.piece.starts(), None
                return np.full_like(found, 1e6) * self.piece.used[:, :, None], np.zeros_like(by_value)
            residual = (found - self.piece.recorded) * counts
            by_value, by_start = by_value * counts[..., None], by_start * counts[..., None]
            normal, cross, gradient = self._sums(residual, by_value, by_start)
            move = -np.linalg.solve(normal, gradient[..., None])[..., 0]
            if not free_starts or step == INNER_STEPS - 1 or np.abs(move / scale).max() < INNER_TOLERANCE:
                break
            self.starts[:, list(self.piece.places)] += move
        if free_starts:
            # To first order, how the optimal starts follow the unknowns.
            follows: Floats = -np.linalg.solve(normal, cross).astype(np.float64)
            self._follow = at, follows
            by_value = by_value + np.einsum("wncd,ndk->wnck", by_start, follows)
        return residual, by_value

    def simulated(self, values: Mapping[str, float]) -> Floats:
        """Return the channels (W, n, C) from the starts as they are."""
        with jax.enable_x64(True):
            return np.asarray(predict(*self._arguments(values)))

    def _arguments(self, values: Mapping[str, float]) -> tuple[Any, ...]:
        piece = self.piece
        return (
            tuple(values),
            piece.places,
            "thrust" in piece.channels,
            self.vehicle,
            jnp.array(list(values.values()), jnp.float64),
            jnp.asarray(self.starts),
            jnp.asarray(piece.commands),
            jnp.asarray(piece.windows),
            piece.log.dt,
        )

    def _sums(self, residual: Floats, by_value: Floats, by_start: Floats) -> tuple[Floats, Floats, Floats]:
        """Return, of each window, the weighted J'J of the starts, that with the unknowns, and J'r."""
        weighted = by_start * weights(residual, self.robust)[..., None]
        normal = np.einsum("wncd,wnce->nde", weighted, by_start)
        # A start that a window does not show (a rate at its last row) stays where it is.
        normal = normal + 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[-1])
        cross = np.einsum("wncd,wnck->ndk", weighted, by_value)
        return normal, cross, np.einsum("wncd,wnc->nd", weighted, residual)


def weights(residual: Floats, robust: bool) -> Floats:
    """Return what a residual counts under the robust loss, scipy's soft_l1 at ROBUST_AT: 1 where it is small."""
    return 1.0 / np.sqrt(1.0 + np.square(residual / ROBUST_AT)) if robust else np.ones_like(residual)
