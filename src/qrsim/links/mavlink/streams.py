"""Which messages go out on a link of a vehicle, and how often."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.mavlink.dialect import BY_NUMBER, LAYOUTS

# Rates [Hz] of simulated time; EACH_FIX goes out when there is one.
EACH_FIX = 0.0
ONBOARD: dict[str, float] = {
    "HEARTBEAT": 1, "ATTITUDE": 100, "ATTITUDE_QUATERNION": 50, "GLOBAL_POSITION_INT": 50, "HIGHRES_IMU": 50,
    "LOCAL_POSITION_NED": 30, "ODOMETRY": 30, "VFR_HUD": 10, "ALTITUDE": 10, "SYS_STATUS": 5, "EXTENDED_SYS_STATE": 5,
    "ESTIMATOR_STATUS": 1, "WIND_COV": 1, "GPS_RAW_INT": EACH_FIX, "SYSTEM_TIME": 1, "HOME_POSITION": 0.5,
    "BATTERY_STATUS": 0.5, "MISSION_CURRENT": 1, "ORBIT_EXECUTION_STATUS": 2, "CURRENT_MODE": 0.5,
    "OBSTACLE_DISTANCE": 10, "OPTICAL_FLOW_RAD": 10, "ADSB_VEHICLE": 10, "EKF_STATUS_REPORT": 1,
}  # fmt: skip
GROUND: dict[str, float] = {
    "HEARTBEAT": 1, "ATTITUDE": 15, "ATTITUDE_QUATERNION": 5, "GLOBAL_POSITION_INT": 5, "LOCAL_POSITION_NED": 3,
    "VFR_HUD": 4, "ALTITUDE": 1, "SYS_STATUS": 1, "EXTENDED_SYS_STATE": 1, "ESTIMATOR_STATUS": 0.5, "WIND_COV": 0.5,
    "GPS_RAW_INT": 1, "SYSTEM_TIME": 1, "HOME_POSITION": 0.5, "BATTERY_STATUS": 0.5, "MISSION_CURRENT": 1,
    "ORBIT_EXECUTION_STATUS": 2, "CURRENT_MODE": 0.5, "OBSTACLE_DISTANCE": 2, "OPTICAL_FLOW_RAD": 1, "ADSB_VEHICLE": 5,
    "EKF_STATUS_REPORT": 0.5,
}  # fmt: skip
# So often at most a message goes out by the wall clock, where the world runs faster than that [Hz].
MOST_HZ = 100.0
# Messages by column of a schedule, the lowest number first.
STREAMED = tuple(sorted(BY_NUMBER))
_COLUMN = {number: column for column, number in enumerate(STREAMED)}
FIX_COLUMN = _COLUMN[LAYOUTS["GPS_RAW_INT"].number]
_FIX = LAYOUTS["GPS_RAW_INT"].number


class Streams:
    """The streams of a link.

    Args:
        rates: by name of the message, see ``ONBOARD``.
        time_step: of the world [s].
        factor: simulated seconds per second of the wall clock.
        by_simulated_time: whether a message may go out more often than ``MOST_HZ`` by the wall clock.
        phase: 0 to 1, by which those of this link come later than those of others, so that not all go out together.

    Attributes:
        changed: a client has asked for other intervals.
    """

    def __init__(
        self,
        rates: Mapping[str, float],
        time_step: float,
        factor: float = 1.0,
        by_simulated_time: bool = False,
        phase: float = 0.0,
    ):
        self._rates = {LAYOUTS[name].number: rate for name, rate in rates.items()}
        self._dt, self._phase = time_step, phase
        self._least = time_step if by_simulated_time else max(time_step, factor / MOST_HZ)
        self._each_fix = False
        # Of each message its interval, and the time of its next frame [ticks]; infinite: it is not sent.
        self._interval: NumpyArray = np.full(len(STREAMED), np.inf)
        self._next: NumpyArray = np.full(len(STREAMED), np.inf)
        self.restart()

    def restart(self) -> None:
        """Reset all messages to the link's default rates, from tick 0."""
        self.changed = False
        self._interval[:] = self._next[:] = np.inf
        for number, rate in self._rates.items():
            if rate == EACH_FIX:
                self._each_fix = True
            else:
                self._begin(number, 1.0 / rate)

    def begin_at(self, tick: int) -> None:
        """Restart the schedule at a tick, with the present intervals."""
        sent = np.isfinite(self._interval)
        self._next[sent] = tick + self._phase * self._interval[sent]

    def _begin(self, number: int, interval: float, tick: int | None = None) -> None:
        """Schedule a message every ``interval`` [s], first in the tick after ``tick``, or by the phase of the link."""
        ticks, column = max(interval, self._least) / self._dt, _COLUMN[number]
        self._interval[column] = ticks
        self._next[column] = self._phase * ticks if tick is None else tick + 1.0

    def set(self, number: int, interval_us: float, tick: int) -> None:
        """Schedule a message every ``interval_us`` [us] of simulated time; 0: default rate, below 0: never."""
        self.changed = True
        self._interval[_COLUMN[number]] = self._next[_COLUMN[number]] = np.inf
        own = self._rates.get(number)
        if number == _FIX:
            self._each_fix = interval_us == 0.0 and own == EACH_FIX
        if interval_us > 0.0:
            self._begin(number, 1e-6 * interval_us, tick)
        elif interval_us == 0.0 and own:
            self._begin(number, 1.0 / own, tick)

    def interval_us(self, number: int) -> int:
        """Return the interval of a message [us]; -1 if it is not sent, 0 if it is sent at every change."""
        if number == _FIX and self._each_fix:
            return 0
        interval = float(self._interval[_COLUMN[number]])
        return -1 if interval == np.inf else round(1e6 * interval * self._dt)

    def due(self, tick: int, fresh: bool) -> list[int]:
        """Return the numbers of the messages that are due at a tick; ``fresh``: a fix has arrived."""
        # Few messages are due at once, and one after the other they take less time than by ``_due``.
        columns: list[int] = (self._next <= tick).nonzero()[0].tolist()
        times = {}
        for column in columns:
            when = times[column] = float(self._next[column])
            # Late ones are not sent after.
            self._next[column] = max(when + float(self._interval[column]), tick + 1e-9)
        columns.sort(key=times.__getitem__)
        if fresh and self._each_fix:
            columns.append(FIX_COLUMN)
        return [STREAMED[column] for column in columns]


class Schedule:
    """The streams of several links, looked up together.

    Args:
        links: streams of each link; they keep their schedules in rows of this one from now on.
    """

    def __init__(self, links: Sequence[Streams]):
        self._links = links
        self._interval = np.stack([streams._interval for streams in links])
        self._next = np.stack([streams._next for streams in links])
        for streams, interval, following in zip(links, self._interval, self._next, strict=True):
            streams._interval, streams._next = interval, following

    def due(self, tick: int, fresh: Sequence[bool]) -> tuple[NumpyArray, NumpyArray]:
        """Return the messages that are due at a tick, each as a link's index (m,) and a column (m,) of ``STREAMED``.

        Args:
            tick: now.
            fresh: of each link whether a fix has arrived.
        """
        return _due(self._links, self._interval, self._next, tick, fresh)


def _due(
    streams: Sequence[Streams], interval: NumpyArray, following: NumpyArray, tick: int, fresh: Sequence[bool]
) -> tuple[NumpyArray, NumpyArray]:
    """Return the result of ``Schedule.due``, and advance ``following`` (n, columns), the times of the next frames."""
    links, columns = np.nonzero(following <= tick)
    when = following[links, columns]
    # Late ones are not sent after.
    following[links, columns] = np.maximum(when + interval[links, columns], tick + 1e-9)
    fixes = [i for i, each in enumerate(streams) if fresh[i] and each._each_fix]
    if fixes:
        links, when = np.append(links, fixes), np.append(when, np.full(len(fixes), np.inf))
        columns = np.append(columns, np.full(len(fixes), FIX_COLUMN))
    order = np.lexsort((when, links))
    return links[order], columns[order]
