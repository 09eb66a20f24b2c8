"""Extremes of recorded runs for the list of a page: closest approaches, worst values, and when runs part."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError
from qrsim.runs.radio_columns import links_logged
from qrsim.runs.radio_links import packets_of
from qrsim.view.satellite_events import first_lost
from qrsim.view.series import BETWEEN, Series

# Time [s], None if it is none of a moment, and text.
Highlight = tuple[float | None, str]
# Distance [m] from which two runs count as apart, and the half width of the 95 % band in standard deviations.
APART, BAND = 1.0, 1.96
SIGMAS, SPEED = "derived.estimate_error_sigmas", "derived.speed"
# Vehicles that one highlight names after the first.
MOST_NAMED = 8
# Links with fewer packets than this are not compared.
FEWEST_PACKETS = 10
# Quantity, whether its largest value counts, and text with places for the vehicle and the value.
FENCE = "derived.fence_distance"
# Kind of the event of a vehicle that stopped because it left its area; its log ends at the last place inside.
LEFT = "out_of_area"
EXTREMES: tuple[tuple[str, bool, str], ...] = (
    (FENCE, False, "closest to the fence: {}, {:.2f} m"),
    ("derived.nearest_vehicle", False, "closest to another vehicle: {}, {:.2f} m"),
    ("derived.wind_speed", True, "strongest wind: {}, {:.1f} m/s"),
    ("derived.estimate_error", True, "largest error of the estimate: {}, {:.2f} m"),
    ("derived.setpoint_distance", True, "farthest from the set-point: {}, {:.2f} m"),
    ("truth.battery.charge", False, "lowest battery: {}, {:.1%}"),
)


def highlights_of(runs: Sequence[Series]) -> list[Highlight]:
    """Return (time [s] or None, text) of notable moments of runs, such as extremes; unlogged quantities are skipped."""
    found = [
        line for name, most, words in EXTREMES for own in runs for line in _guarded(_extreme, own, name, most, words)
    ]
    for find in (_outside, _stopped, _lost_satellite, _apart, _worst_link):
        found += [line for own in runs for line in _guarded(find, own)]
    return found


def _guarded(find: Callable[..., Iterator[Highlight]], *given: object) -> list[Highlight]:
    """Return the highlights that ``find(*given)`` yields; none if a part of the log is damaged."""
    with suppress(QrsimError):
        return list(find(*given))
    return []


def _named(own: Series, vehicle: int) -> str:
    """Return a vehicle's name, preceded by the letter of its run if there are several runs."""
    return f"{own.member.letter} {own.member.recording.run.vehicles[vehicle]}".strip()


def _of_run(own: Series) -> str:
    """Return the end of a highlight's text that names its run, such as ": A"; "" if there is a single run."""
    return f": {own.member.letter}" if own.member.letter else ""


def _extreme(own: Series, name: str, most: bool, words: str) -> Iterator[Highlight]:
    """Yield the first time [s] at which a quantity was largest (``most``) or smallest; ``words``: text template."""
    if name not in own.quantities:
        return
    time, values = own.values(name)
    values = np.where(np.isfinite(values) & _counts(own, time), values, -np.inf if most else np.inf)
    if not values.size:
        return
    row, vehicle = np.unravel_index(np.argmax(values) if most else np.argmin(values), values.shape)
    value = float(values[row, vehicle])
    beyond = list(_beyond_fence(own, time, values)) if name == FENCE else []
    if beyond:
        yield from beyond
    elif np.isfinite(value):
        yield float(time[row]), words.format(_named(own, int(vehicle)), value)


def _beyond_fence(own: Series, time: Floats, values: Floats) -> Iterator[Highlight]:
    """Yield which vehicles were outside the fence (distances ``values`` < 0), with times [s], the earliest first.

    Args:
        own: the run.
        time: (T,) [s].
        values: distances (T, n) [m], infinite where they do not count.
    """
    first = {i: float(time[np.argmax(rows)]) for i, rows in enumerate((values < 0.0).T) if rows.any()}
    for event, vehicle in own.member.recording.stops:
        if event.kind == LEFT:
            at = event.time + own.member.shift
            first[vehicle] = min(at, first.get(vehicle, at))
    reached = sorted((at, vehicle) for vehicle, at in first.items() if at >= 0.0)
    if not reached:
        return
    (at, vehicle), *others = reached
    later = time > at + 1e-6
    back = np.flatnonzero(np.isfinite(values[later, vehicle]) & (values[later, vehicle] >= 0.0))
    until = f"to {time[later][back[0]]:.2f} s" if len(back) else "on"
    then = _then(others, own.member.recording.run.vehicles)
    yield at, f"outside the fence: {_named(own, vehicle)} from {at:.2f} s {until}{then}"


def _then(others: Sequence[tuple[float, int]], names: Sequence[str]) -> str:
    """Return the end of a highlight's text: further vehicles with their times [s], such as "; then b 3.10 s"."""
    also = [f"{names[i]} {at:.2f} s" for at, i in others[:MOST_NAMED]]
    more = [f"{len(others) - MOST_NAMED} more"] if len(others) > MOST_NAMED else []
    return f"; then {', '.join([*also, *more])}" if also else ""


def _counts(own: Series, time: Floats) -> Floats:
    """Return whether each vehicle was in flight (T, n) at times (T,) [s]."""
    ends = np.full(len(own.member.recording.run.vehicles), np.inf)
    for event, vehicle in own.member.recording.stops:
        ends[vehicle] = event.time + own.member.shift
    return np.asarray((time[:, None] >= 0.0) & (time[:, None] <= ends + 1e-6))


def _first_above(own: Series, name: str, level: float) -> tuple[float, int] | None:
    """Return (time [s], vehicle) when a quantity first exceeded ``level``; None if never or not logged."""
    if name not in own.quantities:
        return None
    time, values = own.values(name)
    with np.errstate(invalid="ignore"):
        above = (values > level) & _counts(own, time)
    rows = np.flatnonzero(above.any(axis=1))
    return (float(time[rows[0]]), int(np.argmax(above[rows[0]]))) if len(rows) else None


def _outside(own: Series) -> Iterator[Highlight]:
    """Yield the estimates that left their 95 % band, each with its first time [s], the earliest first."""
    if SIGMAS not in own.quantities:
        return
    time, values = own.values(SIGMAS)
    with np.errstate(invalid="ignore"):
        above = (values > BAND) & _counts(own, time)
    outside = [(float(time[np.argmax(rows)]), i) for i, rows in enumerate(above.T) if rows.any()]
    if not outside:
        yield None, f"estimate never outside its 95 % band{_of_run(own)}"
        return
    (first, vehicle), *others = sorted(outside)
    then = _then(others, own.member.recording.run.vehicles)
    yield first, f"estimate first outside its 95 % band: {_named(own, vehicle)}{then}"


def _stopped(own: Series) -> Iterator[Highlight]:
    """Yield for each vehicle that stopped, as after a collision, its last speed [m/s] before."""
    if SPEED not in own.quantities:
        return
    time, values = own.values(SPEED)
    for event, vehicle in sorted(own.member.recording.stops, key=lambda stop: stop[0].time)[:MOST_NAMED]:
        rows = np.flatnonzero(time < event.time + own.member.shift - 1e-6)
        if len(rows) and np.isfinite(speed := float(values[rows[-1], vehicle])):
            yield float(time[rows[-1]]), f"speed before it stopped: {_named(own, vehicle)}, {speed:.1f} m/s"


def _lost_satellite(own: Series) -> Iterator[Highlight]:
    """Yield the time [s] and name of the first satellite that a receiver lost."""
    for event in first_lost([own.member], 1):
        yield event.time, f"first satellite lost: {event.message}"


def _apart(own: Series) -> Iterator[Highlight]:
    """Yield when a vehicle was first 1 m from its position in the first run, and when it was farthest."""
    first = _first_above(own, BETWEEN, APART)
    if first is not None:
        yield first[0], f"first {APART:g} m from run A: {_named(own, first[1])}"
    yield from _extreme(own, BETWEEN, True, "farthest from run A: {}, {:.2f} m")


def _worst_link(own: Series) -> Iterator[Highlight]:
    """Yield the radio link that lost the largest share of its packets, or that no packet was lost."""
    run = own.member.recording.run
    if "measurements" not in run or not links_logged(run["measurements"].columns()):
        return
    sent, heard, _ = packets_of(run).counts()
    lost = np.where(sent >= FEWEST_PACKETS, 1.0 - heard / np.maximum(sent, 1), -1.0)
    sender, receiver = np.unravel_index(np.argmax(lost), lost.shape)
    share = float(lost[sender, receiver])
    if share > 0.0:
        link = f"{_named(own, int(sender))} to {run.vehicles[receiver]}"
        yield None, f"worst radio link: {link}, {share:.1%} of {int(sent[sender, receiver])} packets lost"
    elif share == 0.0:
        yield None, f"radio: no packet lost of {int(sent.sum())} within reach{_of_run(own)}"
