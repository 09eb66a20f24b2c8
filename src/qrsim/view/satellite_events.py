"""When receivers lost single satellites, as events for the list of a page; logs hold the satellites at each tick."""

from __future__ import annotations

from collections.abc import Iterator

from qrsim.models.gnss.constellations import satellite_name
from qrsim.runs.layout import Event
from qrsim.view.readings import Skies
from qrsim.view.recording import Member

LOST = "satellite_lost"
# How often satellites are compared, of long runs and many vehicles less often [Hz].
RATE_HZ = 10.0
# States of a satellite that a receiver uses, and words for the others (models/gnss).
USED, WORDS = (1, 2), {0: "not tracked", 3: "hidden", 4: "jammed"}


def satellites_lost(member: Member) -> Iterator[Event]:
    """Yield an event for each satellite that a vehicle's receiver stopped using in a run, vehicle by vehicle."""
    run, letter = member.recording.run, f"{member.letter} " if member.letter else ""
    skies = Skies(run, member.recording.end, RATE_HZ)
    for name, said in zip(run.vehicles, skies.of_vehicles() if len(skies.time) else (), strict=False):
        before: dict[int, int] = {}
        for k, time in enumerate(skies.time.tolist()):
            now = {
                int(number): int(state)
                for number, state in zip(said["satellite"][:, k], said["satellite_state"][:, k], strict=True)
                if number >= 0
            }
            # A vehicle that has stopped receives nothing, which is no loss.
            for number in (number for number, state in before.items() if now and state in USED):
                state = now.get(number, 0)
                if state not in USED:
                    words = f"{letter}{name} lost {satellite_name(number)}: {WORDS.get(state, 'not tracked')}"
                    tick = round(time / run.info.time_step)
                    yield Event(time + member.shift, tick, name, LOST, None, float(number), words)
            before = now


def satellite_of(event: Event) -> str:
    """Return the satellite that an event is about and why it was lost, such as "G-C3 (hidden)"."""
    return f"{satellite_name(int(event.value or 0))} ({event.message.rpartition(': ')[2]})"


def first_lost(members: list[Member], most: int) -> list[Event]:
    """Return the ``most`` earliest events of satellites lost in all runs, in order of time."""
    found = [event for member in members for event in satellites_lost(member)]
    return sorted((event for event in found if event.time >= 0.0), key=lambda event: event.time)[:most]
