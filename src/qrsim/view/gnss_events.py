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
    """A loss of GNSS of a vehicle.

    Attributes:
        vehicle: its number in the run.
        time: of the loss [s], by the clock of the run.
        then: (text, time [s]) of what followed until GNSS was back.
        counts: whether no receiver was left, or a failsafe reacted.
        reacted: whether a failsafe reacted.
    """

    vehicle: int
    time: float
    then: list[tuple[str, float]] = field(default_factory=list)
    counts: bool = False
    reacted: bool = False


class _Receivers:
    """The receivers of a vehicle, by its events in order of time.

    Args:
        vehicle: its number in the run.
        names: of all receivers.
    """

    def __init__(self, vehicle: int, names: set[str]):
        self._vehicle, self._names = vehicle, names
        self._lost: set[str] = set()
        self._now: Loss | None = None
        self._all: list[Loss] = []

    def hear(self, event: Event) -> None:
        """Take an event of the vehicle."""
        name = (event.field or "").removesuffix(".satellites")
        # Other faults leave a fix, which may be wrong.
        off = event.kind in FAULTS and f": {name} off," in event.message
        if event.kind == FAILSAFE and event.field in POSITION:
            loss = self._loss(event.time)
            loss.counts = loss.reacted = True
            loss.then.append((mode_of(event).removeprefix("failsafe: ") or f"{event.field} lost", event.time))
        elif name in self._names and ((off and event.kind == BEGINS) or event.kind == "fix_lost"):
            self._lost.add(name)
            loss = self._loss(event.time)
            if self._lost == self._names and not loss.counts:
                loss.counts, loss.time = True, event.time
        elif name in self._lost and ((off and event.kind == BACK) or event.kind == "fix_found"):
            self._lost.remove(name)
            if self._now is not None and (self._now.counts or not self._lost):
                self._now.then.append(("GNSS back", event.time))
                self._now = None

    def _loss(self, time: float) -> Loss:
        """Return the present loss, which begins now if there is none."""
        if self._now is None:
            self._now = Loss(self._vehicle, time)
            self._all.append(self._now)
        return self._now

    def told(self) -> Loss | None:
        """Return the first loss that a failsafe reacted to, else the first one; None if no loss counts."""
        losses = [loss for loss in self._all if loss.counts]
        return next((loss for loss in losses if loss.reacted), losses[0] if losses else None)


def losses(run: Run, ends: Floats) -> list[Loss]:
    """Return one loss of GNSS of each vehicle that lost it in flight, the earliest first.

    It is the first one that a failsafe reacted to, else the first one in which no receiver was left.

    Args:
        run: whose events are read.
        ends: (n,) times of the vehicles' stops [s], by the clock of the run; infinite for those that did not stop.

    Raises:
        QrsimError: the events are damaged.
    """
    names = _receivers(run)
    found = {name: _Receivers(number, names) for number, name in enumerate(run.vehicles)}
    order = {name: number for number, name in enumerate(run.vehicles)}
    for event in sorted(run.events if EVENTS in run else [], key=lambda event: event.time):
        if event.vehicle in found and event.time < ends[order[event.vehicle]]:
            found[event.vehicle].hear(event)
    return sorted((loss for each in found.values() if (loss := each.told())), key=lambda loss: loss.time)


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
