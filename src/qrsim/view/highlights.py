"""Extremes of recorded runs for the list of a page: closest approaches, worst values, and when runs part."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError
from qrsim.runs.layout import Event
from qrsim.runs.radio_columns import links_logged
from qrsim.runs.radio_links import out_of_reach, packets_of, radios_of
from qrsim.view.derived import CHARGE, FENCE, TRUE, closest_pairs
from qrsim.view.gnss_events import losses
from qrsim.view.reasons import LEFT, outside_by
from qrsim.view.satellite_events import satellite_of, satellites_lost
from qrsim.view.series import BETWEEN, COLLISION, SAME, Series

# Time [s], None for a line about no single moment, and text.
Line = tuple[float | None, str]
# The same with the section of the list.
Highlight = tuple[float | None, str, str]
# Yields lines about one run.
Find = Callable[[Series], Iterator[Line]]
# Distance [m] from which two runs count as apart, and the half width of the 95 % band in standard deviations.
APART, BAND = 1.0, 1.96
AXIS = "sigma on the worst axis"
SIGMAS, SPEED = "derived.estimate_error_sigmas", "derived.speed"
# Vehicles that one highlight names, and lines of a run for vehicles that stopped, and for those that lost GNSS.
MOST_NAMED, MOST_STOPS, MOST_LOSSES = 5, 9, 3
# Pairs of vehicles of a run that came closest to each other.
MOST_PAIRS = 3
# Links with fewer packets than this are not compared.
FEWEST_PACKETS = 10


def highlights_of(runs: Sequence[Series]) -> list[Highlight]:
    """Return (time [s] or None, text, section) of notable moments of runs; quantities without a log are skipped."""
    return [
        (*line, section)
        for section, finders in _sections()
        for find in finders
        for own in runs
        for line in _guarded(find, own)
    ]


def _sections() -> tuple[tuple[str, tuple[Find, ...]], ...]:
    """Return the sections of the list, in order, and what yields their lines."""

    def largest(name: str, words: str) -> Find:
        """Return the line about the largest value of a quantity; ``words`` as in ``_largest``."""
        return partial(_largest, name=name, words=words)

    return (
        ("stops", (_stops, _at_stops)),
        ("fence", (_fence,)),
        ("separation", (_closest, _apart)),
        (
            "speed and wind",
            (
                largest(SPEED, "fastest: {}, {:.1f} m/s at {:.2f} s"),
                largest("derived.setpoint_distance", "farthest from the set-point: {}, {:.2f} m"),
                largest("derived.wind_speed", "strongest wind: {}, {:.1f} m/s"),
            ),
        ),
        ("estimate", (largest("derived.estimate_error", "largest error of the estimate: {}, {:.2f} m"), _outside)),
        ("GNSS", (_lost_gnss, _lost_satellites)),
        ("radio", (_worst_link,)),
        ("battery", (_battery,)),
    )


def _guarded(find: Find, own: Series) -> list[Line]:
    """Return the lines about a run that ``find`` yields; none if a part of the log is damaged."""
    with suppress(QrsimError):
        return list(find(own))
    return []


def _letter(own: Series) -> str:
    """Return the letter of a run and a space if there are several runs, else ""."""
    return f"{own.member.letter} " if own.member.letter else ""


def _named(own: Series, vehicle: int) -> str:
    """Return a vehicle's name, preceded by the letter of its run if there are several runs."""
    return _letter(own) + own.member.recording.run.vehicles[vehicle]


def _of_run(own: Series) -> str:
    """Return the end of a highlight's text that names its run, such as ": A"; "" if there is a single run."""
    return f": {own.member.letter}" if own.member.letter else ""


def _listed(own: Series, parts: Sequence[tuple[int, str]], between: str = ", ") -> str:
    """Return texts of vehicles (number, text), each after the vehicle's name, in one line; few vehicles are named."""
    names = own.member.recording.run.vehicles
    told = [f"{names[vehicle]} {text}" for vehicle, text in parts[:MOST_NAMED]]
    more = [f"and {len(parts) - MOST_NAMED} more"] if len(parts) > MOST_NAMED else []
    return between.join([*told, *more])


def _shown(own: Series, name: str) -> tuple[Floats, Floats] | None:
    """Return the times (T,) [s] of a quantity from 0 on and its values (T, n), NaN after stops; None if not logged."""
    if name not in own.quantities:
        return None
    time, values = own.values(name)
    first = int(np.searchsorted(time, 0.0))
    return time[first:], values[first:]


def _extreme(own: Series, name: str, sign: float) -> tuple[float, int, float] | None:
    """Return (time [s], vehicle, value) where ``sign`` times a quantity is first largest; None without a value."""
    found = _shown(own, name)
    if found is None or not np.isfinite(found[1]).any():
        return None
    time, values = found
    row, vehicle = np.unravel_index(np.argmax(np.where(np.isfinite(values), sign * values, -np.inf)), values.shape)
    return float(time[row]), int(vehicle), float(values[row, vehicle])


def _largest(own: Series, name: str, words: str) -> Iterator[Line]:
    """Yield when a quantity was largest.

    Args:
        own: the run.
        name: of the quantity.
        words: text with places for the vehicle, the value and, if it names it, the time.
    """
    found = _extreme(own, name, 1.0)
    if found is not None:
        yield found[0], words.format(_named(own, found[1]), found[2], found[0])


def _stops(own: Series) -> Iterator[Line]:
    """Yield how many vehicles stopped, when and why, the first one first."""
    stops = sorted((float(at), vehicle) for vehicle, at in enumerate(own.ends) if np.isfinite(at))
    count = f"stopped: {_letter(own)}{len(stops)} of {len(own.ends)}"
    if stops:
        why = {vehicle: own.member.recording.why(event) for event, vehicle in own.member.recording.stops}
        reasons = _listed(own, [(vehicle, f"{at:.2f} s {why[vehicle]}") for at, vehicle in stops], "; ")
        yield stops[0][0], f"{count}: {reasons}"
    else:
        yield None, count


def _fence(own: Series) -> Iterator[Line]:
    """Yield which vehicles were outside the fence, by how much and when, or the closest approach to it."""
    shown, found = _shown(own, FENCE), _extreme(own, FENCE, -1.0)
    if shown is None:
        return
    time, values = shown
    out: list[tuple[float, int, str]] = []
    stops = {vehicle: event for event, vehicle in own.member.recording.stops if event.kind == LEFT}
    for vehicle, distances in enumerate(values.T):
        end = own.ends[vehicle] if vehicle in stops else np.inf
        rows = np.flatnonzero((distances < 0.0) & (time < end - SAME))
        if len(rows):
            back = np.flatnonzero((distances >= 0.0) & (time > time[rows[0]]))
            until = f"to {time[back[0]]:.2f} s" if len(back) else "on"
            deepest = -np.nanmin(distances)
            out.append((time[rows[0]], vehicle, f"by up to {deepest:.2f} m from {time[rows[0]]:.2f} s {until}"))
        elif vehicle in stops and end >= 0.0:
            out.append((end, vehicle, f"{_by(own, stops[vehicle])}at {end:.2f} s"))
    if out:
        out.sort()
        yield float(out[0][0]), f"outside the fence: {_letter(own)}{_listed(own, [line[1:] for line in out], '; ')}"
    elif found is not None:
        yield found[0], f"closest to the fence: {_named(own, found[1])}, {found[2]:.2f} m"


def _by(own: Series, event: Event) -> str:
    """Return how far outside the area a vehicle stopped, such as "by 0.13 m to the north "; "" if that is unknown."""
    world = own.member.recording.world
    far = outside_by(event.field, event.value, None if world is None else world.area)
    return "" if far is None else f"by {far[0]:.2f} m {far[1]}".strip() + " "


def _closest(own: Series) -> Iterator[Line]:
    """Yield which vehicles came closest to each other while both flew, or collided, and when."""
    time, places = _places(own)
    names, ends = own.member.recording.run.vehicles, own.ends
    found = {(i, j): (apart, float(time[k]), i, j) for apart, k, i, j in closest_pairs(places, MOST_PAIRS)}
    # Vehicles also collide with those that have stopped, and only the event has the distance at a collision.
    for event, vehicle in own.member.recording.stops:
        other = own.nearest_at(vehicle, ends[vehicle], flying=False) if (event.kind, event.field) == COLLISION else None
        if other is None or event.value is None or ends[vehicle] < 0.0:
            continue
        pair = (min(vehicle, other), max(vehicle, other))
        if pair not in found or event.value < found[pair][0]:
            found[pair] = (event.value, float(ends[vehicle]), vehicle, other)
    pairs = sorted(found.values())[:MOST_PAIRS]
    texts = []
    for apart, at, one, other in pairs:
        stopped = f" ({names[other]} had stopped)" if ends[other] < at - SAME else ""
        texts.append(f"{names[one]} and {names[other]}, {apart:.2f} m at {at:.2f} s{stopped}")
    if texts:
        yield pairs[0][1], f"closest pair{'s' if len(texts) > 1 else ''}: {_letter(own)}{'; '.join(texts)}"


def _places(own: Series) -> tuple[Floats, Floats]:
    """Return times (T,) [s] from 0 on and true positions (T, n, 3) NED [m], NaN from each vehicle's stop on."""
    columns = [own.values(name) for name in TRUE]
    first = int(np.searchsorted(columns[0][0], 0.0))
    return columns[0][0][first:], np.stack([values[first:] for _, values in columns], axis=-1)


def _battery(own: Series) -> Iterator[Line]:
    """Yield the lowest charge in flight, and the charges at which other vehicles stopped."""
    shown, found = _shown(own, CHARGE), _extreme(own, CHARGE, -1.0)
    if shown is None or found is None:
        return
    at, lowest, charge = found
    stopped = []
    for vehicle in np.argsort(own.ends, kind="stable").tolist():
        last = _last(shown, vehicle)
        if vehicle != lowest and np.isfinite(own.ends[vehicle]) and last is not None:
            stopped.append((vehicle, f"{100.0 * last[1]:.1f} % at {own.ends[vehicle]:.2f} s"))
    also = f"; at their stops: {_listed(own, stopped)}" if stopped else ""
    yield at, f"lowest battery in flight: {_named(own, lowest)}, {100.0 * charge:.1f} %{also}"


def _firsts_above(own: Series, name: str, level: float) -> list[tuple[float, int]] | None:
    """Return (time [s], vehicle) of each first time that a quantity exceeded ``level``, sorted; None: not logged."""
    shown = _shown(own, name)
    if shown is None:
        return None
    time, values = shown
    with np.errstate(invalid="ignore"):
        above = values > level
    return sorted((float(time[np.argmax(rows)]), vehicle) for vehicle, rows in enumerate(above.T) if rows.any())


def _with_times(own: Series, firsts: Sequence[tuple[float, int]]) -> str:
    """Return vehicles with their times (time [s], vehicle) as text."""
    return _letter(own) + _listed(own, [(vehicle, f"{at:.2f} s") for at, vehicle in firsts])


def _outside(own: Series) -> Iterator[Line]:
    """Yield the estimates that left their 95 % band, each with its first time [s], the earliest first."""
    firsts = _firsts_above(own, SIGMAS, BAND)
    if firsts:
        yield firsts[0][0], f"estimate first outside its 95 % band ({BAND} {AXIS}): {_with_times(own, firsts)}"
    elif firsts is not None:
        yield None, f"estimate never outside its 95 % band ({BAND} {AXIS}){_of_run(own)}"


def _at_stops(own: Series) -> Iterator[Line]:
    """Yield for each vehicle that stopped its last speed [m/s] before, and whether its estimate was in its band."""
    speeds, sigmas = _shown(own, SPEED), _shown(own, SIGMAS)
    for vehicle in np.argsort(own.ends, kind="stable").tolist()[:MOST_STOPS]:
        last = _last(speeds, vehicle)
        if last is None or not np.isfinite(own.ends[vehicle]):
            continue
        off = _last(sigmas, vehicle)
        side = "" if off is None else "outside" if off[1] > BAND else "inside"
        estimate = "" if off is None else f"; estimate {off[1]:.2f} {AXIS}: {side} its 95 % band"
        yield last[0], f"speed before it stopped: {_named(own, vehicle)}, {last[1]:.1f} m/s{estimate}"


def _last(shown: tuple[Floats, Floats] | None, vehicle: int) -> tuple[float, float] | None:
    """Return the last time [s] of a quantity at which a vehicle has a value, and the value; None without one."""
    if shown is None or not np.isfinite(shown[1][:, vehicle]).any():
        return None
    row = int(np.flatnonzero(np.isfinite(shown[1][:, vehicle]))[-1])
    return float(shown[0][row]), float(shown[1][row, vehicle])


def _lost_gnss(own: Series) -> Iterator[Line]:
    """Yield for each vehicle when it first lost GNSS, and what followed until GNSS was back."""
    shift = own.member.shift
    found = [loss for loss in losses(own.member.recording.run, own.ends - shift - SAME) if loss.time + shift >= 0.0]
    for loss in found[:MOST_LOSSES]:
        then = "".join(f"; {words} {at + shift:.2f} s" for words, at in loss.then)
        yield loss.time + shift, f"GNSS lost: {_named(own, loss.vehicle)} {loss.time + shift:.2f} s{then}"
    rest = found[MOST_LOSSES:]
    if rest:
        of = f" of {own.member.letter}" if own.member.letter else ""
        yield rest[0].time + shift, f"GNSS lost: {len(rest)} more vehicle{'s' if len(rest) > 1 else ''}{of}"


def _lost_satellites(own: Series) -> Iterator[Line]:
    """Yield the first satellite that each vehicle's receiver lost, with its time [s]."""
    firsts: dict[int, Event] = {}
    names = own.member.recording.run.vehicles
    for event in satellites_lost(own.member):
        if event.time >= 0.0 and event.vehicle is not None:
            firsts.setdefault(names.index(event.vehicle), event)
    found = sorted(firsts.items(), key=lambda item: item[1].time)
    if found:
        parts = [(vehicle, f"{satellite_of(event)} {event.time:.2f} s") for vehicle, event in found]
        yield found[0][1].time, f"first satellite lost: {_letter(own)}{_listed(own, parts)}"


def _apart(own: Series) -> Iterator[Line]:
    """Yield when each vehicle was first 1 m from its position in the first run, and when one was farthest."""
    firsts = _firsts_above(own, BETWEEN, APART)
    if firsts:
        yield firsts[0][0], f"first {APART:g} m from run A: {_with_times(own, firsts)}"
    yield from _largest(own, BETWEEN, "farthest from run A: {}, {:.2f} m")


def _worst_link(own: Series) -> Iterator[Line]:
    """Yield the radio link that lost the largest share of its packets, or that no packet was lost."""
    run = own.member.recording.run
    if "measurements" not in run or not links_logged(run["measurements"].columns()):
        return
    packets = packets_of(run)
    sent, heard, _ = packets.counts()
    lost = np.where(sent >= FEWEST_PACKETS, 1.0 - heard / np.maximum(sent, 1), -1.0)
    sender, receiver = np.unravel_index(np.argmax(lost), lost.shape)
    share = float(lost[sender, receiver])
    if share > 0.0:
        link = f"{_named(own, int(sender))} to {run.vehicles[receiver]}"
        yield None, f"worst radio link: {link}, {100.0 * share:.1f} % of {int(sent[sender, receiver])} packets lost"
    elif share == 0.0:
        stream = run["measurements"]
        beyond = out_of_reach(packets, stream["radio.sent"][np.searchsorted(stream.time, packets.time)], radios_of(run))
        also = "" if beyond is None else f"; out of reach: {beyond}"
        letter = f" of {own.member.letter}" if own.member.letter else ""
        yield None, f"radio{letter}: no packet lost of {int(sent.sum())} within reach{also}"
