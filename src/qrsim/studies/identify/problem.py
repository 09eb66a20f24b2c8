"""Multiple shooting: a log cut into windows, each simulated from its own initial state, estimated jointly.

The start of a window matters to that window alone. It is therefore found inside (a few Gauss-Newton steps, weighted by
the same robust loss), and what is left to the outer solver are the constants and the few nuisances of each log. At
the inner optimum the derivative of the outer sum is exact although the starts move with the constants.

Where velocity is measured a window has a gust besides: what its wind differs by from the constant wind of the log, and
how that changes from its beginning to its end. A vehicle is carried by slow turbulence, so that its velocity goes with
the wind that a constant leaves out, and drag would come out too small. Gusts are normal; how large they are is
estimated with the noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import cast
from qrsim.errors import LogError
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.studies.flight_logs import FlightLog
from qrsim.studies.flight_logs.signals import SIGNALS, Floats
from qrsim.studies.identify.constants import TILT_COMMANDS, channels_of, nuisances_in
from qrsim.studies.identify.simulate import DRIFT, GUST, PLACE, linearised, predict

# Used where a log has none: no ceiling of the thrust is met.
FULL_BATTERY_V = 12.0
# A start that moves by less than this many standard deviations changes the sum by nothing that matters.
INNER_STEPS, INNER_TOLERANCE = 2, 0.1
# A piece between gaps that is shorter is left out.
SHORTEST_ROWS = 25
# Channels and derivatives beyond this, or that are no numbers, are of no vehicle; their squares are to be numbers.
FAR = 1e100
# The robust loss grows linearly beyond so many standard deviations.
ROBUST_AT = 3.0
# How far a start is believed to be from the record of a channel that counts for nothing.
SILENT_WIDTH = {"rad": 0.1, "rad/s": 0.3, "m/s": 1.0, "N": 5.0}
# Standard deviation of gusts and their drift to begin with, and what they are at least [m/s].
FIRST_GUST, FIRST_DRIFT, SMALLEST_GUST = 0.5, 0.2, 0.01


@dataclass(frozen=True)
class Piece:
    """The part of a log to fit, or the part to score.

    Attributes:
        log: where they are from.
        channels: measured signals.
        nuisances: estimated for this log.
        commands: (T, 5) SI commands of the log from its beginning to the end of the part, gaps held.
        measured: (T, C) measured channels of the whole log.
        windows: (R, n) numbers of the R rows of each of n windows; those beyond the end of a window repeat its last.
        used: (R, n) whether a row counts, as in ``windows``.
        silent: channels that count for nothing, because they were not measured or do not follow their commands.
    """

    log: FlightLog
    channels: tuple[str, ...]
    nuisances: tuple[str, ...]
    commands: Floats
    measured: Floats
    windows: NumpyArray
    used: NumpyArray
    silent: tuple[str, ...] = ()

    @property
    def rows(self) -> NumpyArray:
        """Mask (T,) of the log's rows that are in a window."""
        found = np.zeros(len(self.log.time), bool)
        found[self.windows[self.used]] = True
        return found

    @property
    def places(self) -> tuple[int, ...]:
        """Index of each measured channel of the log among all channels."""
        return tuple(PLACE[name] for name in self.channels)

    @property
    def gusts(self) -> tuple[int, ...]:
        """Columns of gust and drift in a window's initial state; () if the log has no velocity."""
        return (*GUST, *DRIFT) if "velocity_north" in self.channels else ()

    @property
    def recorded(self) -> Floats:
        """Measured channels (R, n, C) at the R rows of each of n windows."""
        return self.measured[self.windows]

    def starts(self) -> Floats:
        """Return initial states (n, 16) of n windows: measured channels, gust and drift; 0 if not measured."""
        starts = np.zeros((self.windows.shape[1], DRIFT[-1] + 1))
        starts[:, list(self.places)] = self.measured[self.windows[0]]
        return starts


def cut(log: FlightLog, horizon: float, first: float = 0.0, last: float = 1.0, whole: bool = False) -> Piece:
    """Cut rows ``first`` to ``last`` (fractions) of a log into windows of ``horizon`` [s]; ``whole``: no shorter ones.

    Args:
        log: what was read.
        horizon: length of a window [s]; at a gap it ends early.
        first, last: shares of the rows.
        whole: leave out windows that are shorter than the horizon.

    Raises:
        LogError: no window is left.
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
        least = min(length, SHORTEST_ROWS) if runs else SHORTEST_ROWS
        raise LogError(
            f"{log.source}: too short: no piece of {least * log.dt:g} s without a gap from"
            f" {first * len(good) * log.dt:.2f} to {last * len(good) * log.dt:.2f} s; --train, --from and --to choose"
            f" other parts{''.join(f'; {note}' for note in log.notes)}"
        )
    # What comes later has no effect on these rows.
    commands = commands[: round(last * len(good))]
    return Piece(log, channels, nuisances_in(channels), commands, measured, np.stack(windows, 1), np.stack(used, 1))


def _commands(log: FlightLog) -> tuple[Floats, NumpyArray]:
    """Return commands (T, 5) in the order of ``Command``, gaps filled, and a mask (T,) of the gaps."""
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


def _runs(good: NumpyArray) -> list[tuple[int, int]]:
    """Return (begin, end) of each run of True in a bool array (T,); end is exclusive."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


class Misfit(NamedTuple):
    """Residuals of a piece's simulation, and their derivatives by K unknowns.

    Attributes:
        residual: simulated minus recorded over the noise, (R, n, C); 0 where a row does not count.
        by_value: (R, n, C, K).
        gust: of each window and its drift over their standard deviations, (n, G).
        gust_by_value: (n, G, K).
    """

    residual: Floats
    by_value: Floats
    gust: Floats
    gust_by_value: Floats


class Shooting:
    """One piece with the initial states of its windows, kept between evaluations."""

    def __init__(self, piece: Piece, vehicle: Quadrotor, robust: bool = True):
        self.piece = piece
        self.vehicle = cast(vehicle, np.float64)
        self.robust = robust
        self.starts = piece.starts()
        # Standard deviations of the gusts and drifts [m/s].
        self.gust = np.array([FIRST_GUST] * 3 + [FIRST_DRIFT] * 3)[: len(piece.gusts)]
        self._follow: tuple[Floats, Floats] | None = None
        self._gust_variance = np.zeros(len(piece.gusts))

    def misfit(self, values: Mapping[str, float], noise: Mapping[str, float]) -> Misfit:
        """Simulate the windows; return residuals and derivatives by ``values``, with optimal initial states.

        Args:
            values: of the unknowns by name.
            noise: standard deviation of each channel, which residuals are divided by.
        """
        piece, free = self.piece, [*self.piece.places, *self.piece.gusts]
        scale = np.array([noise[name] for name in piece.channels])
        counts = piece.used[:, :, None] / scale
        at = np.array(list(values.values()))
        if self._follow is not None and len(self._follow[0]) == len(at):
            self.starts[:, free] += self._follow[1] @ (at - self._follow[0])
        for step in range(INNER_STEPS):
            with jax.enable_x64(True):
                parts = linearised(piece.places, tuple(free), **self._arguments(values))
                found, by_value, by_start = (np.asarray(part) for part in parts)
            if not all((np.abs(part) < FAR).all() for part in (found, by_value, by_start)):
                # The solver tried constants that no vehicle has; it comes back from there.
                self.starts, self._follow = piece.starts(), None
                gust = np.zeros((len(self.starts), len(self.gust)))
                far = np.full_like(found, 1e6) * piece.used[:, :, None]
                return Misfit(far, np.zeros_like(by_value), gust, np.zeros((*gust.shape, len(at))))
            residual = (found - piece.recorded) * counts
            by_value, by_start = by_value * counts[..., None], by_start * counts[..., None]
            normal, cross, gradient = self._sums(residual, by_value, by_start)
            move = -np.linalg.solve(normal, gradient[..., None])[..., 0]
            if step == INNER_STEPS - 1 or np.abs(move / [*scale, *self.gust]).max() < INNER_TOLERANCE:
                break
            self.starts[:, free] += move
        # To first order, how the optimal starts follow the unknowns.
        follows: Floats = -np.linalg.solve(normal, cross).astype(np.float64)
        self._follow = at, follows
        by_value = by_value + np.einsum("wncd,ndk->wnck", by_start, follows)
        own = len(piece.places)
        self._gust_variance = np.linalg.inv(normal)[:, range(own, len(free)), range(own, len(free))].mean(axis=0)
        return Misfit(residual, by_value, self._gusts() / self.gust, follows[:, own:] / self.gust[:, None])

    def learn_gust(self) -> None:
        """Update the gusts' standard deviations [m/s], horizontal and vertical, from the last misfit (an EM step)."""
        if len(self.gust):
            variance = np.square(self._gusts()).mean(axis=0) + self._gust_variance
            north, east, down = variance.reshape(2, 3).T
            across = (north + east) / 2.0
            self.gust = np.maximum(np.sqrt(np.stack([across, across, down], axis=1).ravel()), SMALLEST_GUST)

    def _gusts(self) -> Floats:
        """Return gust and drift [m/s] at the start of each window, (n, G)."""
        return self.starts[:, list(self.piece.gusts)]

    def simulated(self, values: Mapping[str, float]) -> Floats:
        """Simulate the measured channels (R, n, C) of all windows from the present initial states."""
        with jax.enable_x64(True):
            return np.asarray(predict(self.piece.places, **self._arguments(values)))

    def _arguments(self, values: Mapping[str, float]) -> dict[str, object]:
        """Return keyword arguments for every simulation of the windows; ``values`` are the unknowns by name."""
        piece = self.piece
        return {
            "names": tuple(values),
            "thrust_measured": "thrust" in piece.channels,
            "vehicle": self.vehicle,
            "unknowns": jnp.array(list(values.values()), jnp.float64),
            "starts": jnp.asarray(self.starts),
            "commands": jnp.asarray(piece.commands),
            "windows": jnp.asarray(piece.windows),
            "dt": piece.log.dt,
        }

    def _sums(self, residual: Floats, by_value: Floats, by_start: Floats) -> tuple[Floats, Floats, Floats]:
        """Return each window's weighted J'J of initial states, J'J of them with the unknowns, and J'r."""
        weighted = by_start * weights(residual, self.robust)[..., None]
        normal = np.einsum("wncd,wnce->nde", weighted, by_start)
        # A start that a window does not show (a rate at its last row) stays where it is.
        normal = normal + 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[-1])
        cross = np.einsum("wncd,wnck->ndk", weighted, by_value)
        gradient = np.einsum("wncd,wnc->nd", weighted, residual)
        own = len(self.piece.places)
        gusts = range(own, normal.shape[-1])
        normal[:, gusts, gusts] += 1.0 / self.gust**2
        gradient[:, own:] += self._gusts() / self.gust**2
        # What no residual holds stays near what was measured.
        for place, name in ((i, name) for i, name in enumerate(self.piece.channels) if name in self.piece.silent):
            width = SILENT_WIDTH[SIGNALS[name].unit]
            at = self.piece.places[place]
            normal[:, place, place] += 1.0 / width**2
            gradient[:, place] += (self.starts[:, at] - self.piece.measured[self.piece.windows[0], place]) / width**2
        return normal, cross, gradient


def weights(residual: Floats, robust: bool) -> Floats:
    """Return the weight, 0 to 1, of each residual under the robust loss (SciPy's soft_l1 at ROBUST_AT)."""
    return 1.0 / np.sqrt(1.0 + np.square(residual / ROBUST_AT)) if robust else np.ones_like(residual)
