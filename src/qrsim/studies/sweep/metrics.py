"""Metrics of an episode: one number each, from those of its vehicles."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from qrsim.core.arrays import NumpyArray

Found = Mapping[str, NumpyArray]


@dataclass(frozen=True)
class Metric:
    """A number of an episode.

    Attributes:
        unit: its unit, "1" for counts.
        doc: what it means.
        of: from the metrics of all vehicles (W, n, ...) to that of the episodes (W,); NaN where it is not defined.
        low_is_bad: whether small values are the bad ones.
        task: whether only a task that its baseline flies has it.
        mission: whether it is one of ``MissionMetrics``; a run with one ends when its missions are over.
        limits: between which it is, whatever is flown.
    """

    unit: str
    doc: str
    of: Callable[[Found], NumpyArray]
    low_is_bad: bool = False
    task: bool = False
    limits: tuple[float, float] = (0.0, np.inf)
    mission: bool = False


def _over(reduce: Callable[..., NumpyArray], name: str) -> Callable[[Found], NumpyArray]:
    """Return a function that reduces the metric ``name`` (W, n) of vehicles to one value per episode, ignoring NaN."""

    def of(found: Found) -> NumpyArray:
        """Return a metric (W,) of W episodes, reduced over vehicles; NaN if no vehicle has a value."""
        with warnings.catch_warnings():
            # A vehicle without a value does not count; an episode in which nobody has one has none.
            warnings.simplefilter("ignore", RuntimeWarning)
            return reduce(np.asarray(found[name], np.float64), axis=1)

    return of


def _if_known(reduce: Callable[..., NumpyArray], name: str) -> Callable[[Found], NumpyArray]:
    """Return a function that reduces ``name`` to one value per episode; NaN in worlds that do not measure it."""
    of = _over(reduce, name)
    return lambda found: of(found) if name in found else np.full(len(found["reason"]), np.nan)


def _root_mean_square(values: NumpyArray, axis: int) -> NumpyArray:
    """Return the root mean square along an axis, ignoring NaN."""
    return np.sqrt(np.nanmean(values * values, axis=axis))


def _stopped(*kinds: str) -> Callable[[Found], NumpyArray]:
    """Return a function that counts an episode's vehicles that stopped for one of the reasons ``kinds``, or any."""

    def of(found: Found) -> NumpyArray:
        """Return the number of vehicles (W,) of W episodes that stopped for one of the reasons."""
        from qrsim.models.scene.area import REASONS

        bad = [code for code, (kind, _) in enumerate(REASONS) if code and (not kinds or kind in kinds)]
        return np.isin(found["reason"], bad).sum(axis=1).astype(np.float64)

    return of


def _not_finished(found: Found) -> NumpyArray:
    """Return the number of vehicles (W,) of W episodes that have not finished their mission."""
    # NaN for a vehicle without a mission, such as the station of a radio.
    return np.sum(np.asarray(found["finished"]) == 0.0, axis=1).astype(np.float64)


def _end_error(found: Found) -> NumpyArray:
    """Return the root mean square over vehicles of the distance to the goal at the end [m], (W,) for W episodes."""
    offset = np.asarray(found["position_ned"], np.float64) - found["goal_ned"]
    return _root_mean_square(np.sqrt(np.sum(offset * offset, axis=-1)), axis=1)


def _of_least(name: str, part: str) -> Callable[[Found], NumpyArray]:
    """Return a function that gives ``part``, a metric or "vehicle", of each episode's vehicle with least ``name``."""

    def of(found: Found) -> NumpyArray:
        """Return a value (W,) of each episode's vehicle with the smallest metric; NaN if no vehicle has the metric."""
        values = np.asarray(found[name], np.float64)
        vehicle = np.argmin(np.where(np.isnan(values), np.inf, values), axis=1)
        parts = np.broadcast_to(np.arange(values.shape[1]), values.shape)
        if part != "vehicle":
            parts = np.where(np.isnan(values), np.nan, np.asarray(found[part], np.float64))
        seen = ~np.isnan(values).all(axis=1)
        return np.where(seen, parts[np.arange(len(values)), vehicle], np.nan)

    return of


def _mission(metric: Metric) -> Metric:
    """Return a copy of a metric, marked as one that only missions have."""
    return replace(metric, mission=True)


_MARGINS = {
    "ground_min": "smallest height above the ground between take-off and landing",
    "obstacle_min": "smallest distance to an obstacle in flight",
    "fence_horizontal_min": "smallest distance to the sides of the area in flight",
    "ceiling_min": "smallest distance to its ceiling in flight",
    "air_separation_min": "smallest distance between two vehicles in flight",
}


def _of_missions() -> dict[str, Metric]:
    """Return name -> metric for all metrics of missions."""
    found = {
        "not_finished": Metric("1", "vehicles that did not finish their mission", _not_finished),
        "finished_s": Metric(
            "s", "time at which the last vehicle finished its mission", _over(np.nanmax, "finished_s")
        ),
        "down_s": Metric(
            "s", "time at which the last vehicle finished, or was landed by a failsafe", _over(np.nanmax, "down_s")
        ),
        "charge_end": Metric(
            "1",
            "charge left at the end of the mission, of the worst vehicle",
            _over(np.nanmin, "charge_end"),
            low_is_bad=True,
            limits=(0.0, 1.0),
        ),
        "home_m": Metric(
            "m", "horizontal distance from the start at the end, of the farthest vehicle", _over(np.nanmax, "home_m")
        ),
        "in_the_air": Metric("1", "vehicles in the air at the end", _over(np.sum, "in_the_air")),
        "crashed": Metric(
            "1",
            "vehicles that hit the ground, crashed, or lost their battery",
            _stopped("hit_ground", "crashed", "brown_out", "battery_empty"),
        ),
        "stopped_s": Metric("s", "time at which the first vehicle stopped", _over(np.nanmin, "stopped_at_s")),
        "stopped_leg": Metric(
            "1", "leg of the first vehicle that stopped, from 1", _of_least("stopped_at_s", "stopped_at_leg")
        ),
        "stopped_vehicle": Metric(
            "1", "number of the first vehicle that stopped", _of_least("stopped_at_s", "vehicle")
        ),
        "failsafe_s": Metric("s", "time at which the first failsafe took over", _over(np.nanmin, "failsafe_at_s")),
    }
    for margin, doc in _MARGINS.items():
        found[f"{margin}_m"] = Metric(
            "m", doc, _over(np.nanmin, f"{margin}_m"), low_is_bad=True, limits=(-np.inf, np.inf)
        )
        for part, unit, words in (("at_s", "s", "time of it"), ("leg", "1", "leg on which it was, from 1")):
            found[f"{margin}_{part}"] = Metric(unit, words, _of_least(f"{margin}_m", f"{margin}_{part}"))
        found[f"{margin}_vehicle"] = Metric("1", "number of the vehicle", _of_least(f"{margin}_m", "vehicle"))
    return {name: _mission(metric) for name, metric in found.items()}


METRICS: dict[str, Metric] = {
    "tracking_error_rms_m": Metric(
        "m", "distance from the leg being flown, or from the waypoint that is held; RMS over time and vehicles",
        _over(_root_mean_square, "tracking_error_rms_m"),
    ),
    "tracking_error_max_m": Metric("m", "largest such distance", _over(np.nanmax, "tracking_error_max_m")),
    "end_error_m": Metric("m", "distance from the last waypoint at the end, RMS over vehicles", _end_error),
    "gnss_horizontal_rms_m": Metric(
        "m", "horizontal error of the fixes, RMS over fixes and vehicles",
        _over(_root_mean_square, "gnss_horizontal_rms_m"),
    ),
    "gnss_vertical_rms_m": Metric("m", "the same, vertical", _over(_root_mean_square, "gnss_vertical_rms_m")),
    "without_fix_s": Metric("s", "time without a fix, of the worst vehicle", _over(np.nanmax, "without_fix_s")),
    "clipped_s": Metric("s", "time with a clipped command, of the worst vehicle", _over(np.nanmax, "clipped_s")),
    "wind_max_m_s": Metric("m/s", "largest speed of the air at a vehicle, gusts included",
                           _over(np.nanmax, "wind_max_m_s")),
    "distance_m": Metric("m", "length of the true path, mean over vehicles", _over(np.nanmean, "distance_m")),
    "separation_min_m": Metric("m", "smallest distance between two vehicles", _over(np.nanmin, "separation_min_m"),
                               low_is_bad=True),
    "fence_distance_min_m": Metric("m", "smallest distance to the edge of the area; the ground is none",
                                   _over(np.nanmin, "fence_distance_min_m"), low_is_bad=True,
                                   limits=(-np.inf, np.inf)),
    **{
        f"fence_{part}_min_m": Metric("m", f"the same, to its {part} alone", _over(np.nanmin, f"fence_{part}_min_m"),
                                      low_is_bad=True, limits=(-np.inf, np.inf))
        for part in ("lateral", "ceiling", "floor")
    },
    "breaches": Metric("1", "times that vehicles left the zones of an area that reports it",
                       _if_known(np.sum, "breaches")),
    "seconds_outside": Metric("s", "time outside these zones, of the worst vehicle",
                              _if_known(np.nanmax, "seconds_outside")),
    "endurance_s": Metric("s", "time for which the battery would last at the mean consumption in the air, shortest",
                          _over(np.nanmin, "endurance_s"), low_is_bad=True),
    "charge_min": Metric("1", "lowest charge of a battery, its reserve at the end",
                         _over(np.nanmin, "charge_min"), low_is_bad=True, limits=(0.0, 1.0)),
    "anees": Metric("1", "squared errors of the estimate over those it states, per error (1 is right); mean over time "
                    "and vehicles", _over(np.nanmean, "anees")),
    **{
        f"anees_{what}": Metric("1", f"the same, of the {what}", _over(np.nanmean, f"anees_{what}"))
        for what in ("position", "velocity", "attitude", "bias")
    },
    "flown_s": Metric("s", "time until the first vehicle stopped, or the end", _over(np.nanmin, "flown_s"),
                      low_is_bad=True),
    "unfinished": Metric("1", "vehicles still on their mission at the end", _over(np.sum, "unfinished")),
    "failsafes": Metric("1", "vehicles that a failsafe flew",
                        lambda found: np.sum(found["failsafe_action"] > 0, axis=1)),
    "stopped": Metric("1", "vehicles that stopped, for whatever reason", _stopped()),
    "collided": Metric("1", "vehicles that collided", _stopped("collision")),
    "left_area": Metric("1", "vehicles that left the area", _stopped("out_of_area")),
    "persons_found": Metric("1", "persons found", lambda found: found["persons_found"], low_is_bad=True, task=True),
    "found_share": Metric("1", "part of the persons that were found", lambda found: found["found_share"],
                          low_is_bad=True, task=True, limits=(0.0, 1.0)),
    "first_found_s": Metric("s", "time of the first find", lambda found: found["first_found_s"], task=True),
    **_of_missions(),
}  # fmt: skip


def of_episodes(names: tuple[str, ...], found: Found, own: Mapping[str, Metric]) -> dict[str, NumpyArray]:
    """Reduce metrics of vehicles (W, n, ...) to the named metrics of W episodes, each (W,), in float32.

    Args:
        names: built-in ones and own ones.
        found: of all vehicles.
        own: a user's.
    """
    known = {**METRICS, **own}
    return {name: np.asarray(known[name].of(found), np.float32) for name in names}
