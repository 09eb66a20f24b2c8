"""Satellite orbits from an SP3 file, by Lagrange interpolation of degree 11; ``sp3_file`` reads the file."""

from __future__ import annotations

import math
from collections import Counter
from functools import cached_property

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array, lax

from qrsim.core.tree import cast, quantity, record, record_of, setting
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError, warn_user
from qrsim.models.gnss.orbits import EARTH_ROTATION_RATE, SPEED_OF_LIGHT, Ephemeris
from qrsim.models.gnss.receivers import FEWEST_SATELLITES
from qrsim.models.gnss.sp3_file import SYSTEMS, Sp3File, read_sp3
from qrsim.models.site import Float64, Site, utc_from_gps_seconds

DEGREE = 11
NEAR_END_S = 1800.0
# Of a tick's polynomials: they miss the interpolation by 0.4 mm over 15 minutes of a GPS orbit.
_TICK_DEGREE = 5
_FIRST_FLIGHT_S = 0.075


def lagrange_basis(nodes: npt.ArrayLike, points: npt.ArrayLike) -> Float64:
    """Return the Lagrange basis polynomials (..., n), on nodes (n,), at points (...) in the nodes' unit.

    By products, not the barycentric quotient, so that a point on a node needs no special case.
    """
    node = np.asarray(nodes, np.float64)
    distance = np.asarray(points, np.float64)[..., None] - node
    one = np.ones_like(distance[..., :1])
    below = np.cumprod(np.concatenate((one, distance[..., :-1]), axis=-1), axis=-1)
    above = np.cumprod(np.concatenate((one, distance[..., :0:-1]), axis=-1), axis=-1)[..., ::-1]
    spacing = node[:, None] - node + np.eye(len(node))
    return np.asarray(below * above / np.prod(spacing, axis=-1))


@record
class Sp3Orbits:
    """Satellite positions as seen from a site, by a polynomial per interval; ``Sp3Ephemeris.at`` makes it.

    Positions are NaN where the file gives none, and outside its span.
    """

    coefficients: Array = quantity(
        unit="m", doc="(M, 6, 3, S) for each of M intervals: highest power first; north, east, down; satellites"
    )
    interval: Array = quantity(unit="s", doc="() int32, length of an interval")
    seconds: Array = quantity(unit="s", doc="() int32, whole seconds from the first epoch to the start")
    fraction: Array = quantity(unit="s", doc="() the rest of them, in [0, 1)")

    def positions_ned(self, seconds: Array, fraction: Array) -> Vec3:
        """Return the satellites' positions (S,) [m] NED, as received at a time; see ``Orbits.positions_ned``."""
        count = self.coefficients.shape[0]
        since_first = self.seconds + seconds
        index = jnp.clip(since_first // self.interval, 0, count - 1)
        into = (since_first - index * self.interval).astype(fraction.dtype) + (self.fraction + fraction)
        # It runs from -1 to 1 over an interval.
        argument = into / (0.5 * self.interval.astype(fraction.dtype)) - 1.0
        powers = lax.dynamic_index_in_dim(self.coefficients, index, keepdims=False)
        position = powers[0]
        for power in range(1, powers.shape[0]):
            position = position * argument + powers[power]
        inside = (since_first >= 0) & (since_first <= count * self.interval)
        position = jnp.where(inside, position, math.nan)
        return Vec3(position[0], position[1], position[2])


@record
class Sp3Ephemeris(Ephemeris):
    """Satellite orbits from an SP3 file, interpolated by polynomials of degree 11 through the 12 nearest epochs.

    A satellite is used between two epochs where it has 12 or more positions in a row around them, and no manoeuvre in
    between. On circular orbits with an epoch every 15 minutes, in millimetres, the error is 1 mm in mid-arc, and 2 cm
    in the first and last interval of a row of positions.
    """

    file: str = setting(doc="path of an SP3 file, version a, c or d")
    systems: str | None = setting(
        default=None,
        doc="letters of the satellite systems used, such as GE: GPS and Galileo; default: those of receivers of type "
        "gnss that the file has, and G without any",
    )

    @cached_property
    def data(self) -> Sp3File:
        """Content of the SP3 file, read on first use; raises UsageError as ``read_sp3`` does."""
        return read_sp3(self.file)

    @property
    def satellites(self) -> tuple[str, ...]:
        """Names of the S satellites used from the file, such as G05."""
        return tuple(self.data.satellites[column] for column in self._columns)

    @property
    def system_of(self) -> str:
        """GNSS system letter of each of the S satellites used from the file, as text."""
        return "".join(name[0] for name in self.satellites)

    @property
    def satellite_ids(self) -> npt.NDArray[np.uint32]:
        """Number (S,) of each satellite, the same for every file: 256 times its letter's code, plus its PRN."""
        return np.array([256 * ord(name[0]) + int(name[1:]) for name in self.satellites], np.uint32)

    @property
    def span_gps_seconds(self) -> tuple[float, float]:
        """First and last epoch of the file [GPS s]."""
        times = self.data.gps_seconds
        return float(times[0]), float(times[-1])

    @property
    def cut_off(self) -> str:
        """Text to append to error messages if the file may be truncated, with a semicolon in front; else ""."""
        return f"; {self.data.cut_off}" if self.data.cut_off else ""

    def positions_ecef(self, gps_seconds: npt.ArrayLike) -> Float64:
        """Return the satellites' Earth-fixed positions (..., S, 3) [m] at times (...) [GPS s]; NaN in data gaps.

        Raises:
            UsageError: a time is outside the file's span.
        """
        since_first = self._since_first(gps_seconds)
        flat = since_first.reshape(-1)
        return self._interpolate(flat[:, None], self._interval_of(flat)).reshape(*since_first.shape, -1, 3)

    def received_ned(self, site: Site, gps_seconds: npt.ArrayLike) -> Float64:
        """Return positions (..., S, 3) [m] NED as received at a site at times (...) [GPS s]; see ``Orbits``.

        Raises:
            UsageError: a time is outside the file's span.
        """
        since_first = self._since_first(gps_seconds)
        flat = since_first.reshape(-1)
        return self._received(site, flat, self._interval_of(flat)).reshape(*since_first.shape, -1, 3)

    def notes(self, start_gps_seconds: float, duration_s: float = math.inf) -> tuple[str, ...]:
        """Return messages to the user about the file's orbits in a run, one sentence each.

        They are the file's own notes, nearness to the ends of its span, satellites that it lacks or loses on the way,
        and too few of them. A run of unknown, infinite duration is looked at to the end of the file, whose nearness
        is then no news.
        """
        first, last = self.span_gps_seconds
        end = min(start_gps_seconds + duration_s, last)
        found = list(self.data.notes)
        late = last - end if math.isfinite(duration_s) else math.inf
        for distance, which in ((start_gps_seconds - first, "start"), (late, "end")):
            if distance < NEAR_END_S:
                found.append(
                    f"{self.file}: the run comes within 30 minutes of the {which} of the file's span, "
                    f"{self._span_text()}, where interpolation loses accuracy"
                )
        low, high = self._interval_of(np.array([start_gps_seconds, end]) - first)
        lost = self._wanted & (self._windows[low : high + 1] < 0).any(axis=0)
        names = [self.data.satellites[column] for column in np.flatnonzero(lost)]
        if names:
            why = next((self.data.gaps[name] for name in names if name in self.data.gaps), "epochs are missing")
            found.append(f"{self.file}: not available during all of the run: {', '.join(names)} ({why})")
        unlocated = [name for name in self.data.unlocated if name[0] in self._letters]
        if unlocated:
            found.append(f"{self.file}: in the header's list, but without positions: {', '.join(unlocated)}")
        fewest = int(np.min(np.sum(self._windows[low : high + 1, self._wanted] >= 0, axis=1)))
        if fewest < FEWEST_SATELLITES:
            found.append(
                f"{self.file}: only {fewest} satellites of systems '{self._letters}' have positions during the run or "
                f"a part of it; a fix needs {FEWEST_SATELLITES}"
            )
        return tuple(found)

    def at(self, site: Site, start_gps_seconds: float, dtype: npt.DTypeLike, duration_s: float = math.inf) -> Sp3Orbits:
        """Return the orbits as seen from a site, over the whole file, for a run; each of ``notes`` becomes a warning.

        Args:
            site: where the signals are received.
            start_gps_seconds: time of tick 0 [GPS s].
            dtype: float32 or float64, the run's precision.
            duration_s: how long the run lasts; infinite: not known, and then only its start is checked.

        Raises:
            UsageError: the run is not inside the file's span.
        """
        since_first = float(self._since_first(start_gps_seconds))
        if math.isfinite(duration_s):
            self._since_first(start_gps_seconds + duration_s)
        for note in self.notes(start_gps_seconds, duration_s):
            warn_user(note)
        count, interval = len(self.data.clocks) - 1, self.data.interval
        argument = np.cos(math.pi * (np.arange(_TICK_DEGREE + 1) + 0.5) / (_TICK_DEGREE + 1))
        times = interval * (np.arange(count)[:, None] + 0.5 + 0.5 * argument)
        intervals = np.repeat(np.arange(count), len(argument))
        sampled = self._received(site, times.reshape(-1), intervals).reshape(count, len(argument), -1, 3)
        coefficients = np.einsum("pn,knsa->kpas", np.linalg.inv(np.vander(argument)), sampled)
        whole = math.floor(since_first)
        fields = (np.int32(interval), np.int32(whole), np.float64(since_first - whole))
        return cast(record_of(Sp3Orbits, coefficients, *fields), dtype)

    @cached_property
    def _wanted(self) -> npt.NDArray[np.bool_]:
        """(S of the file,) bool: ``systems`` has the satellite's system; raises UsageError for missing systems."""
        letters = self._letters
        if not letters or set(letters) - set(SYSTEMS):
            known = ", ".join(f"{letter} ({name})" for letter, name in SYSTEMS.items())
            raise UsageError(f"systems: '{letters}' does not consist of letters of satellite systems: {known}")
        lacking = self.lacking(letters)
        if lacking:
            which = "" if lacking == letters else f" of '{letters}'"
            raise UsageError(f"{self.file}: no satellite of systems '{lacking}'{which}; the file has {self.content}")
        return np.array([name[0] in letters for name in self.data.satellites])

    @property
    def content(self) -> str:
        """Satellite systems in the file and their numbers of satellites, as text for messages."""
        has = Counter(name[0] for name in self.data.satellites)
        return ", ".join(f"{letter} ({SYSTEMS[letter]}): {count}" for letter, count in has.items())

    def lacking(self, systems: str) -> str:
        """Return the letters of ``systems`` for which the file has no satellites."""
        there = {name[0] for name in self.data.satellites}
        return "".join(letter for letter in systems if letter not in there)

    @property
    def _letters(self) -> str:
        """Letters of the satellite systems used from the file."""
        return "G" if self.systems is None else self.systems

    @cached_property
    def _columns(self) -> npt.NDArray[np.intp]:
        """Column indices (S,) of the file's satellites that are used; raises UsageError if none is."""
        usable = np.flatnonzero(self._wanted & (self._windows >= 0).any(axis=0))
        if not len(usable):
            raise UsageError(
                f"{self.file}: no satellite of systems '{self._letters}' has positions at {DEGREE + 1} epochs in a "
                f"row, which interpolation needs; the file has {len(self.data.clocks)} epochs{self.cut_off}"
            )
        return usable

    @cached_property
    def _windows(self) -> npt.NDArray[np.intp]:
        """Index of the first of 12 epochs that interpolate each interval (E - 1, satellites of the file); -1: none."""
        present = np.isfinite(self.data.positions_ecef[..., 0])
        joined = present[1:] & present[:-1] & ~self.data.manoeuvre[1:]
        windows = np.full(joined.shape, -1, np.intp)
        for column, series in enumerate(joined.T):
            breaks = np.flatnonzero(~series)
            for low, high in zip((0, *(breaks + 1)), (*breaks, len(series)), strict=True):
                if high - low >= DEGREE:
                    windows[low:high, column] = np.clip(np.arange(low, high) - DEGREE // 2, low, high - DEGREE)
        return windows

    def _interval_of(self, since_first: Float64) -> npt.NDArray[np.intp]:
        """Return the index of the interval between epochs for times [s] after the first epoch."""
        return np.clip(since_first // self.data.interval, 0, len(self.data.clocks) - 2).astype(np.intp)

    def _interpolate(self, since_first: Float64, intervals: npt.NDArray[np.intp]) -> Float64:
        """Return positions (T, S, 3) [m] at (T, 1) or (T, S) [s] after the first epoch, in the intervals (T,)."""
        window = self._windows[intervals][:, self._columns]
        basis = lagrange_basis(np.arange(DEGREE + 1), since_first / self.data.interval - window)
        total = np.zeros((*window.shape, 3))
        for node in range(DEGREE + 1):
            total += basis[..., node, None] * self.data.positions_ecef[window + node, self._columns]
        return np.where(window[..., None] < 0, np.nan, total)

    def _received(self, site: Site, since_first: Float64, intervals: npt.NDArray[np.intp]) -> Float64:
        """Return positions (T, S, 3) [m] NED as received at a site at times (T,) [s] after the first epoch."""
        origin, to_ned = site.origin_ecef(), site.ned_from_ecef_rotation()
        flight = _FIRST_FLIGHT_S
        # Each round shrinks the error of the travel time, 0.02 s at first, by 1e5.
        for _ in range(3):
            x, y, z = np.moveaxis(self._interpolate(since_first[:, None] - flight, intervals), -1, 0)
            # While the signal travels the Earth turns on, and the position falls back to the west.
            cosine, sine = np.cos(EARTH_ROTATION_RATE * flight), np.sin(EARTH_ROTATION_RATE * flight)
            ray = np.stack((cosine * x + sine * y, cosine * y - sine * x, z), axis=-1) - origin
            flight = np.linalg.norm(ray, axis=-1) / SPEED_OF_LIGHT
        return np.asarray(ray @ to_ned.T)

    def _since_first(self, gps_seconds: npt.ArrayLike) -> Float64:
        """Return times (...) as seconds after the first epoch; raises UsageError for one outside the file's span."""
        times = np.asarray(gps_seconds, np.float64)
        first, last = self.span_gps_seconds
        # NaN fails this comparison too.
        wrong = times[~((times >= first) & (times <= last))]
        if wrong.size:
            worst = float(wrong[0])
            when = f"{utc_from_gps_seconds(worst):%Y-%m-%d %H:%M:%S} UTC" if worst >= 0.0 else f"GPS second {worst}"
            raise UsageError(f"{self.file}: {when} is outside the file's span, {self._span_text()}{self.cut_off}")
        return np.asarray(times - first)

    def _span_text(self) -> str:
        """Return the file's first and last epoch in UTC, as text."""
        first, last = (f"{utc_from_gps_seconds(time):%Y-%m-%d %H:%M:%S}" for time in self.span_gps_seconds)
        return f"{first} to {last} UTC"
