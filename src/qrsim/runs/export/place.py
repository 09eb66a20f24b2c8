"""Place on the Earth and time of a run."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
import numpy.typing as npt
from pydantic import AwareDatetime, BaseModel, ValidationError

from qrsim.errors import RunError
from qrsim.models.site import Site
from qrsim.runs import Run
from qrsim.scenarios.site_schema import SiteSpec

Floats = npt.NDArray[np.float64]
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class _Recorded(BaseModel):
    """The only parts of a resolved scenario that are needed, so that one of another version of qrsim is no obstacle."""

    site: SiteSpec
    start_time: AwareDatetime


@dataclass(frozen=True)
class Place:
    """Origin of the run's frame and of its time.

    Attributes:
        site: of the origin of the local NED frame.
        start_us: time of the start [us since 1970, UTC].
    """

    site: Site
    start_us: int

    def geodetic(self, position_ned: npt.ArrayLike) -> Floats:
        """Convert NED [m] (..., 3) to latitude [deg], longitude [deg] and height above the ellipsoid [m] (..., 3)."""
        latitude, longitude, height = self.site.ned_to_geodetic(position_ned)
        return np.stack((np.degrees(latitude), np.degrees(longitude), height), axis=-1)

    def nanoseconds(self, times: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Convert simulated times [s] to nanoseconds since 1970 (UTC, no leap seconds)."""
        return self.start_us * 1000 + np.round(np.asarray(times, np.float64) * 1e9).astype(np.int64)

    def utc(self, times: npt.ArrayLike) -> list[str]:
        """Convert simulated times (T,) [s] to UTC times in ISO 8601, to the microsecond."""
        since_1970 = self.start_us + np.round(np.asarray(times, np.float64) * 1e6).astype(np.int64)
        text: list[str] = np.datetime_as_string(since_1970.astype("datetime64[us]"), timezone="UTC").tolist()
        return text


def place_of(run: Run) -> Place:
    """Return the geodetic origin and the start time (UTC) of a run, from its resolved scenario.

    Raises:
        RunError: the scenario does not say so.
    """
    source = str(run.folder / "scenario.yaml")
    try:
        recorded = _Recorded.model_validate(run.scenario)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(step) for step in first["loc"])
        raise RunError(f"{source} does not say where and when the run took place: {where}: {first['msg']}") from error
    site = recorded.site
    start_us = (recorded.start_time - EPOCH) // timedelta(microseconds=1)
    return Place(site.at(), start_us)
