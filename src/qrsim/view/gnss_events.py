"""Losses of GNSS among the events of recorded runs: one line for each vehicle, and words for searches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from qrsim.core.arrays import Floats
from qrsim.runs import Run
from qrsim.runs.failsafe_events import ENDS, FAILSAFE
from qrsim.runs.layout import EVENTS, Event
from qrsim.view.details import mode_of

BEGINS, BACK = "fault_begins", "fault_ends"
# Kinds of events of scheduled faults, and of receivers that lose or regain their fix (runs/streams.py).
FAULTS, FIXES = (BEGINS, BACK), ("no_fix", "fix_lost", "fix_found")
# Fields of events of failsafes that act on a lost position.
POSITION = ("fix", "position")
# Found by searches for these events besides their own words.
WORD = "gnss"


@dataclass
class Loss:
    """The first loss of GNSS of a vehicle.

    Attributes:
        vehicle: its number in the run.
        time: of the loss [s], by the clock of the run.
        then: (text, time [s]) of what followed until GNSS was back.
        over: whether it was back.
    """

    vehicle: int
    time: float
    then: list[tuple[str, float]] = field(default_factory=list)
    over: bool = False


def losses(run: Run, ends: Floats) -> list[Loss]:
    """Return the first loss of GNSS of each vehicle that lost it in flight, the earliest first.

    Args:
        run: whose events are read.
        ends: (n,) times of the vehicles' stops [s], by the clock of the run; infinite for those that did not stop.

    Raises:
        QrsimError: the events are damaged.
    """
    sensors, numbers = _receivers(run), {name: i for i, name in enumerate(run.vehicles)}
    found: dict[int, Loss] = {}
    for event in sorted(run.events if EVENTS in run else [], key=lambda event: event.time):
        vehicle = numbers.get(event.vehicle or "")
        if vehicle is None or event.time >= ends[vehicle]:
            continue
        reacts = event.kind == FAILSAFE and event.field in POSITION
        # Other faults leave a fix, which may be wrong.
        off = event.field in sensors and f": {event.field} off," in event.message
        if reacts or (off and event.kind == BEGINS) or event.kind == "fix_lost":
            found.setdefault(vehicle, Loss(vehicle, event.time))
        loss = found.get(vehicle)
        if loss is None or loss.over:
            continue
        if reacts:
            loss.then.append((mode_of(event).removeprefix("failsafe: ") or f"{event.field} lost", event.time))
        elif event.kind == "fix_found" or (off and event.kind == BACK):
            loss.then.append(("GNSS back", event.time))
            loss.over = True
    return sorted(found.values(), key=lambda loss: loss.time)


def _receivers(run: Run) -> set[str]:
    """Return the names of the sensors that report a position and how many satellites they use."""
    columns = set(run["measurements"].columns()) if "measurements" in run else set()
    names = {name.removesuffix(".satellites") for name in columns if name.endswith(".satellites")}
    return {name for name in names if f"{name}.position_ned.x" in columns}


def search_words(events: Iterable[Event]) -> Iterator[str]:
    """Yield for each event of a page, in order of time, the words beyond its text that searches find it by."""
    last: dict[tuple[str, str | None], str | None] = {}
    for event in events:
        # Several runs have vehicles of one name; their events' texts begin with the letter of the run.
        whose = event.message.partition(":")[0], event.vehicle
        if event.kind == FAILSAFE:
            last[whose] = event.field
        of_position = event.kind in (FAILSAFE, ENDS) and last.get(whose) in POSITION
        yield WORD if of_position or event.kind in FIXES else ""
