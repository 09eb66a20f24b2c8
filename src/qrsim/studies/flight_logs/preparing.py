"""Resamples logged signals to one regular grid: order, duplicates, gaps, units."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from qrsim.errors import LogError, visible
from qrsim.studies.flight_logs.signals import ANGLES, SIGNALS, FlightLog, Floats, Track

DT = 0.02
# No value is invented over a hole longer than this [s]; commands are held a little longer, battery much longer.
LONGEST_GAP, LONGEST_HOLD, LONGEST_BATTERY_HOLD = 0.25, 1.0, 10.0
# No flight is longer [s]; a clock that jumps would otherwise ask for any amount of memory.
SHORTEST_S, LONGEST_S = 4.0, 36_000.0


def prepare(path: Path, kind: str, tracks: Mapping[str, Track], notes: list[str], dt: float = DT) -> FlightLog:
    """Resample the signals of a log over their common time, every ``dt`` [s].

    Measured signals are interpolated linearly and commands held; gaps become NaN. Everything that was changed is in
    the log's notes.

    Raises:
        LogError: nothing usable, no time in common, too short, or a signal whose unit cannot be right.
    """
    if not tracks:
        raise LogError(f"{path}: no signal of a vehicle in this {kind}; known: {', '.join(SIGNALS)}")
    notes = list(notes)
    clean = {name: _cleaned(path, name, track, notes) for name, track in tracks.items()}
    for name, track in clean.items():
        _check_unit(path, name, track.values)
    first = max(track.time[0] for track in clean.values())
    last = min(track.time[-1] for track in clean.values())
    if last - first < SHORTEST_S:
        spans = ", ".join(f"{name} {track.time[0]:.3f} to {track.time[-1]:.3f} s" for name, track in clean.items())
        raise LogError(
            f"{path}: too short: its signals have {max(0.0, last - first):.2f} s in common, at least {SHORTEST_S:g} s"
            f" are needed; {spans}"
        )
    if last - first > LONGEST_S:
        raise LogError(f"{path}: {_describe_jump(clean, first, last)}")
    grid = first + dt * np.arange(int((last - first) / dt + 1e-6) + 1)
    signals = {name: _sampled(name, track, grid, notes) for name, track in clean.items()}
    rates = {name: 1.0 / float(np.median(np.diff(track.time))) for name, track in clean.items()}
    different = sorted({f"{rate:.3g}" for rate in rates.values()}, key=float)
    notes.append(
        f"{len(grid)} rows of {dt:g} s, {grid[-1] - grid[0]:.2f} s, from signals logged at {', '.join(different)} Hz"
    )
    return FlightLog(path.stem, path, kind, dt, grid - grid[0], signals, _merged_notes(notes, list(signals)), rates)


def _describe_jump(tracks: Mapping[str, Track], first: float, last: float) -> str:
    """Return as text at which time a log's clock jumps, for logs that are too long."""
    steps = {each: float(np.max(np.diff(other.time))) for each, other in tracks.items()}
    name = max(steps, key=lambda each: steps[each])
    at = int(np.argmax(np.diff(tracks[name].time)))
    before, after = tracks[name].time[at : at + 2]
    return (
        f"its signals go from {first:.6g} s to {last:.6g} s, {last - first:.4g} s; allowed: up to {LONGEST_S:g} s; the "
        f"largest step of the clock: {name} from {before:.6g} s to {after:.6g} s, {after - before:.4g} s"
    )


def _merged_notes(notes: list[str], names: list[str]) -> list[str]:
    """Return one note per line; equal notes on several signals become one."""
    whom: dict[str, list[str]] = {}
    for note in map(visible, notes):
        name, _, what = note.partition(": ")
        if name in names:
            whom.setdefault(what, []).append(name)
        else:
            whom[note] = []
    return [
        f"all signals: {what}" if len(who) == len(names) > 1 else f"{', '.join(who)}: {what}" if who else what
        for what, who in whom.items()
    ]


def _cleaned(path: Path, name: str, track: Track, notes: list[str]) -> Track:
    """Return a signal's track in order of time, without NaN and repeated times; adds notes on what was dropped."""
    time, values = track.time, track.values
    good = np.isfinite(time) & np.isfinite(values)
    if not good.all():
        notes.append(f"{name}: {int((~good).sum())} of {len(good)} samples are not finite numbers; left out")
        time, values = time[good], values[good]
    if len(time) < 2:
        raise LogError(f"{path}: {name}: {len(time)} usable samples of {len(good)}; at least 2 are needed")
    backwards = int((np.diff(time) < 0).sum())
    if backwards:
        share = backwards / len(time)
        if share > 0.05:
            where = int(np.argmax(np.diff(time) < 0))
            raise LogError(
                f"{path}: {name}: time goes back {backwards} times in {len(time)} samples, first from"
                f" {time[where]:.6g} s to {time[where + 1]:.6g} s; expected a time that increases"
            )
        notes.append(f"{name}: time goes back {backwards} times; samples sorted by time")
        order = np.argsort(time, kind="stable")
        time, values = time[order], values[order]
    # Of samples with the same time the last counts.
    last = np.append(np.diff(time) > 0, True)
    if not last.all():
        notes.append(f"{name}: {int((~last).sum())} samples have the time of another; the last of each counts")
        time, values = time[last], values[last]
    if len(time) < 2:
        raise LogError(f"{path}: {name}: all samples have the time {time[0]:.6g} s")
    if name in ANGLES:
        turns = np.round(values[0] / (2.0 * np.pi))
        values = np.unwrap(values) - 2.0 * np.pi * turns
    return Track(time, values)


def _check_unit(path: Path, name: str, values: Floats) -> None:
    """Raise LogError for a signal with values that only a wrong unit would explain."""
    signal = SIGNALS[name]
    size = float(np.quantile(np.abs(values if name != "yaw" else values - values[0]), 0.99))
    guess = {"rad": "degrees", "rad/s": "degrees per second", "1": "per cent", "V": "millivolts", "m/s": "cm/s"}
    if size > signal.largest:
        raise LogError(
            f"{path}: {name}: its unit is suspect: 1 % of the values are beyond {size:.4g} {signal.unit}, and"
            f" {signal.largest:g} {signal.unit} is the most that is believed; is it in"
            f" {guess.get(signal.unit, 'another unit')}?"
        )


def _sampled(name: str, track: Track, grid: Floats, notes: list[str]) -> Floats:
    """Sample a signal's track at the times ``grid``: measurements interpolated, commands held, NaN in gaps."""
    time, values = track.time, track.values
    before = np.clip(np.searchsorted(time, grid + 1e-9, side="right") - 1, 0, len(time) - 2)
    command = SIGNALS[name].command
    if command:
        held = np.clip(np.searchsorted(time, grid + 1e-9, side="right") - 1, 0, len(time) - 1)
        result = values[held]
    else:
        result = np.interp(grid, time, values)
    limit = LONGEST_BATTERY_HOLD if name == "battery" else LONGEST_HOLD if command else LONGEST_GAP
    # A signal logged slowly on purpose has no gaps.
    limit = max(limit, 3.0 * float(np.median(np.diff(time))))
    wide = np.diff(time)[before] > limit
    inside = wide & (grid > time[before] + 1e-9) & (grid < time[before + 1] - 1e-9)
    if inside.any():
        holes = np.unique(before[inside])
        largest = holes[np.argmax(np.diff(time)[holes])]
        plural = "" if len(holes) == 1 else "s"
        notes.append(
            f"{name}: {len(holes)} gap{plural} longer than {limit:.2g} s, the longest {np.diff(time)[largest]:.2f} s at"
            f" {time[largest] - grid[0]:.2f} s; not filled"
        )
        result = np.where(inside, np.nan, result)
    return result
