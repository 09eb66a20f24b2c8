"""Quality of service: which topics are sent again where they are lost, and how many messages are kept."""

from __future__ import annotations

from dataclasses import dataclass

from qrsim.links.ros2.topics import Quality


@dataclass(frozen=True)
class Profile:
    """Quality of service: whether lost samples are sent again, how many are kept, and whether for late readers."""

    reliable: bool
    depth: int
    latched: bool = False


PROFILES: dict[Quality, Profile] = {
    "sensor": Profile(reliable=False, depth=5),
    "reliable": Profile(reliable=True, depth=10),
    "clock": Profile(reliable=False, depth=1),
    "static": Profile(reliable=True, depth=1, latched=True),
    # As mavros subscribes: a reader of best effort hears reliable writers too.
    "command": Profile(reliable=False, depth=1),
    # As PX4's bridge publishes, and hears commands, of which several may come at once.
    "fmu": Profile(reliable=False, depth=1, latched=True),
    "request": Profile(reliable=False, depth=10),
    "service": Profile(reliable=True, depth=10),
}
