"""Several recorded runs in one scene: the first as it was, the others over it, at the times of the first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError, RunError, UsageError
from qrsim.models.vehicles.contracts import Outline
from qrsim.runs import Run
from qrsim.runs.layout import Event
from qrsim.view.aligning import shift_of
from qrsim.view.details import Details
from qrsim.view.frame import Cast, Frame
from qrsim.view.imagery import Imagery
from qrsim.view.paint import JoinedPaints
from qrsim.view.recording import Member, Recording
from qrsim.view.sky import Satellite
from qrsim.world.state import World

# Runs that their colours tell apart.
MOST_RUNS = 6
LETTERS = "ABCDEF"
# Origins of sites that are farther apart than this [m] are not on one map.
FARTHEST_M = 20_000.0
# Kind of the mark where one of the runs ends before the others.
RUN_ENDS = "run_ends"


class Several:
    """Recorded runs over each other, with what a page needs of a ``Recording``.

    Time is that of the first run; another run is shown ``shift`` later than it was flown. Area, obstacles, wind and
    links are those of the first run.

    Args:
        recordings: at least two; the first one whole.
        align: None: all begin together; otherwise the event that happens at the same time in all (see ``aligning``).

    Raises:
        UsageError: one of the runs has no such event.

    Attributes:
        cast: vehicles of all runs, with the letter of their run in front of their names.
        time: (T,) times that are shown [s].
        members: the runs.
        stops: events of vehicles that stopped, and the number of the vehicle.
        notes: what does not fit, one line each.
        paints: quantities that can colour vehicles and paths.
        imagery: picture of the ground to show with them; None: none.
    """

    def __init__(self, recordings: list[Recording], align: str | None = None):
        shifts = [0.0] * len(recordings) if align is None else shift_of([found.run for found in recordings], align)
        offsets = [_offset(recordings[0].run, found.run) for found in recordings]
        self.members, first = [], 0
        for letter, found, shift, (offset, _) in zip(LETTERS, recordings, shifts, offsets, strict=False):
            self.members.append(Member(letter, found, shift, first, offset))
            first += found.cast.size
        self._first = recordings[0]
        self.world: World | None = self._first.world
        self.run, self.shown = self._first.run, max(found.shown for found in recordings)
        self.cast = _cast(self.members)
        self.paints = JoinedPaints(
            [(member.recording.paints, member.shift, member.recording.cast.size) for member in self.members]
        )
        self.imagery: Imagery | None = None
        self.end = max(member.end for member in self.members)
        own = self._first.time
        step = float(np.median(np.diff(own))) if len(own) > 1 else self.run.info.time_step
        self.time = np.append(own, np.arange(own[-1] + step, self.end + 0.5 * step, step))
        self.stops: list[tuple[Event, int]] = []
        self._whys: dict[Event, str] = {}
        for member in self.members:
            for event, number in member.recording.stops:
                shown = replace(event, time=event.time + member.shift)
                self.stops.append((shown, number + member.first))
                self._whys[shown] = member.recording.why(event)
        self.notes = [
            line
            for member, (_, far) in zip(self.members, offsets, strict=True)
            for line in _notes(member, self._first.run, far)
        ]

    @property
    def title(self) -> str:
        """Names of the scenarios of all runs."""
        return ", ".join(dict.fromkeys(member.recording.title for member in self.members))

    @property
    def heading(self) -> str:
        """Title line of the page: scenarios, and letter, folder and seed of each run."""
        return f"{self.title}, {len(self.members)} runs: " + "; ".join(map(_name, self.members))

    @cached_property
    def events(self) -> list[Event]:
        """Events of all runs at the times shown, and the end of each run that ends before the last one."""
        found = []
        for member in self.members:
            for event in member.recording.events:
                words = event.message or event.kind
                found.append(replace(event, time=event.time + member.shift, message=f"{member.letter}: {words}"))
            if member.end < self.end - 1e-6:
                tick = round(member.end / self.run.info.time_step)
                found.append(Event(member.end, tick, None, RUN_ENDS, None, None, f"{member.letter} ends"))
        return sorted((event for event in found if event.time >= 0.0), key=lambda event: event.time)

    def frame(self, time: float) -> Frame:
        """Return what the page draws of all runs at a time [s]; before its start and after its end a run is still."""
        row = max(0, int(np.searchsorted(self.time, time + 1e-6, side="right")) - 1)
        now = float(self.time[row])
        frames = [member.recording.frame(now - member.shift) for member in self.members]
        reasons = {
            number + member.first: why
            for frame, member in zip(frames, self.members, strict=True)
            for number, why in frame.reasons.items()
        }
        arrays = [own.name for own in fields(Frame) if isinstance(getattr(frames[0], own.name), np.ndarray)]
        joined: dict[str, Any] = {name: np.concatenate([getattr(frame, name) for frame in frames]) for name in arrays}
        for name in ("position_ned", "estimate_ned", "ghost_ned"):
            own = [getattr(frame, name) + member.offset for frame, member in zip(frames, self.members, strict=True)]
            joined[name] = np.concatenate(own)
        details = cache(lambda: _joined_details(self.members, [known() for known in map(_details, frames)]))
        # What is not one value a vehicle is of the first run; of some of it layers need all vehicles.
        beside, links = frames[0].beside, frames[0].links
        return Frame(time=now, reasons=reasons, beside=beside, links=links, details=details, **joined)

    @property
    def modes(self) -> list[tuple[float, int, str]]:
        """Changes of failsafes' actions in all runs, in order: (time [s], vehicle number, text), "" when one ends."""
        return sorted(
            (time + member.shift, vehicle + member.first, words)
            for member in self.members
            for time, vehicle, words in member.recording.modes
        )

    def why(self, event: Event) -> str:
        """Return in words why a vehicle has stopped, from its event in ``stops``."""
        return self._whys[event]

    def positions(self, times: Floats) -> Floats:
        """Return the true positions (K, n, 3) [m] in the first run's frame at times (K,) [s]."""
        return self._joined(times, lambda member: member.recording.positions)

    def estimates(self, times: Floats) -> Floats:
        """Return measured positions (K, n, 3) [m] in the first run's frame at times (K,) [s]."""
        return self._joined(times, lambda member: member.recording.estimates)

    def _joined(self, times: Floats, of: Callable[[Member], Callable[[Floats], Floats]]) -> Floats:
        """Return positions (K, n, 3) [m] of all runs in the first run's frame; ``of``: run -> its function of time."""
        parts = [of(member)(np.asarray(times) - member.shift) + member.offset for member in self.members]
        return np.concatenate(parts, axis=1)

    def sky(self, vehicle: int, time: float) -> list[Satellite]:
        """Return the satellites that a vehicle's receiver reported at a time [s]; [] without any."""
        member = self._member(vehicle)
        return member.recording.sky(vehicle - member.first, time - member.shift)

    def _member(self, vehicle: int) -> Member:
        """Return the run of a vehicle, given by its number among the vehicles of all runs."""
        return [member for member in self.members if member.first <= vehicle][-1]


def open_several(
    folders: Iterable[Path], open_run: Callable[[Path], Run], align: str | None = None
) -> tuple[Recording | Several, list[str]]:
    """Open run folders to show together, shifted to ``align`` an event; return the recording, and warnings.

    Args:
        folders: at least one.
        open_run: opens a run folder.
        align: see ``Several``.

    Returns:
        The recording, and what is not shown as it was, one line each.

    Raises:
        UsageError: there is no run in one of the folders, there are too many, or one has no such event.
        RunError: none of the runs can be shown.
    """
    found: list[Recording] = []
    lines: list[str] = []
    failed: QrsimError | None = None
    folders = list(folders)
    if len(folders) > MOST_RUNS:
        raise UsageError(f"{len(folders)} runs: expected at most {MOST_RUNS}, which colours can tell apart")
    for folder in folders:
        try:
            found.append(Recording(open_run(folder), found[0] if found else None))
        except RunError as error:
            if len(folders) == 1:
                raise
            failed = error
            lines.append(f"not shown: {error}")
    if not found:
        assert failed is not None
        raise failed
    if len(found) == 1:
        return found[0], [*lines, *found[0].notes]
    several = Several(found, align)
    return several, [*lines, *several.notes]


def _details(frame: Frame) -> Callable[[], Details]:
    """Return the function that reads the details (speeds, attitude ...) of a recorded frame's vehicles."""
    assert frame.details is not None
    return frame.details


def _joined_details(members: list[Member], each: list[Details]) -> Details:
    """Return the details of the vehicles of all runs, with positions in the first run's frame."""
    names = [own.name for own in fields(Details) if own.name != "modes"]
    parts: dict[str, Any] = {name: np.concatenate([getattr(own, name) for own in each]) for name in names}
    believed = [own.believed_ned + member.offset for own, member in zip(each, members, strict=True)]
    parts["believed_ned"] = np.concatenate(believed)
    pairs = zip(each, members, strict=True)
    modes = {number + member.first: words for own, member in pairs for number, words in own.modes.items()}
    return Details(**parts, modes=modes)


def _name(member: Member) -> str:
    """Return a run's letter, folder name and seed as text, such as "run A (first, seed 1)"."""
    run = member.recording.run
    return f"run {member.letter} ({run.folder.resolve().name}, seed {run.info.seed})"


def _cast(members: list[Member]) -> Cast:
    """Return the scene's fixed content of all runs, such as shapes, starts and paths, in the first run's frame."""
    casts = [member.recording.cast for member in members]
    fleets: list[Any] = []
    outlines: list[Outline | None] = []
    for own in casts:
        fleets.append(own.fleets + len(outlines))
        outlines += own.outlines or (None,) * (int(own.fleets.max(initial=0)) + 1)
    flown = [cast.flown + member.offset for cast, member in zip(casts, members, strict=True) if cast.flown is not None]
    none = np.zeros((0, 3))
    return Cast(
        tuple(f"{member.letter} {name}" for member, own in zip(members, casts, strict=True) for name in own.names),
        np.concatenate(fleets),
        np.concatenate([own.start_ned + member.offset for own, member in zip(casts, members, strict=True)]),
        casts[0].around,
        tuple(outlines),
        casts[0].places,
        (*(casts[0].routes or (none,) * casts[0].size), *(none for own in casts[1:] for _ in own.names)),
        np.vstack(flown) if flown else None,
        tuple(map(_name, members)),
        np.repeat(np.arange(len(members)), [own.size for own in casts]),
        casts[0].site,
        tuple(count for own in casts for count in own.waypoints),
    )


def _offset(first: Run, other: Run) -> tuple[Floats, float]:
    """Return the origin (3,) [m] of the run ``other`` in the first run's frame, and its distance [m] from the first's.

    Origins that are too far for one map lie on each other.
    """
    here, there = _origin(first), _origin(other)
    nowhere = np.zeros(3)
    if here is None or there is None or here == there:
        return nowhere, 0.0
    from qrsim.models.site import Site

    site = Site.from_degrees(*here)
    found = site.geodetic_to_ned(math.radians(there[0]), math.radians(there[1]), there[2])
    far = float(np.linalg.norm(found))
    return (found, far) if far <= FARTHEST_M else (nowhere, far)


def _origin(run: Run) -> tuple[float, float, float] | None:
    """Return (latitude [deg], longitude [deg], height [m]) of a run's origin; None if unknown or invalid."""
    site = run.scenario.get("site") if isinstance(run.scenario, dict) else None
    if not isinstance(site, dict):
        return None
    values = [site.get(name, 0.0) for name in ("latitude_deg", "longitude_deg", "height")]
    if not all(isinstance(value, int | float) and np.isfinite(value) for value in values):
        return None
    if abs(values[0]) > 90.0 or abs(values[1]) > 360.0:
        return None
    return float(values[0]), float(values[1]), float(values[2])


def _notes(member: Member, first: Run, far: float) -> Iterator[str]:
    """Yield lines if a run has not ended, and on how it differs from the first (``far``: distance of sites [m])."""
    run, letter = member.recording.run, f"{member.letter} ({member.recording.run.folder})"
    yield from (f"{letter}: {note}" for note in member.recording.notes)
    if run is first:
        return
    if run.info.scenario != first.info.scenario:
        yield f"{letter}: scenario '{run.info.scenario}'; area and wind are those of '{first.info.scenario}'"
    version, other = (own.info.versions.get("qrsim", "unknown") for own in (run, first))
    if version != other:
        yield f"{letter}: recorded by qrsim {version}, the first run by {other}"
    if far > FARTHEST_M:
        yield f"{letter}: its site is {far / 1000.0:.0f} km from that of the first run; their origins lie on each other"
    elif far > 0.0:
        yield f"{letter}: its origin is {far:.1f} m from that of the first run; it is drawn there"
    same = set(run.vehicles) & set(first.vehicles)
    if not same:
        yield f"{letter}: no vehicle has the name of one of the first run, so no differences are drawn"
    elif len(same) < max(len(run.vehicles), len(first.vehicles)):
        yield f"{letter}: vehicles that the first run has too: {len(same)}; only these have differences"
    if member.shift < 0.0:
        yield (
            f"{letter}: its first {-member.shift:.2f} s are before the start of the first run and are not shown; "
            "name it first to see them"
        )
