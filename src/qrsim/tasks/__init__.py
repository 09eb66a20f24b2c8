"""Tasks: from actions to set-points, with reward, end of episode and observation. One file per family.

A task is a record with pure methods, like every component; ``contracts.py`` lists them. ``play.py`` flies its episodes.
It may import ``simulation`` and the layers below it.
Read ``play.py`` first.
"""

from qrsim.tasks.formation import KeepFormation
from qrsim.tasks.landing import Land
from qrsim.tasks.play import Episode, Play, Step
from qrsim.tasks.plume_mapping import PlumeMapping
from qrsim.tasks.pursuit import Pursuit
from qrsim.tasks.search import Search
from qrsim.tasks.simple import KeepSpot, KeepVelocity, NoTask, ReachWaypoint

__all__ = [
    "Episode",
    "KeepFormation",
    "KeepSpot",
    "KeepVelocity",
    "Land",
    "NoTask",
    "Play",
    "PlumeMapping",
    "Pursuit",
    "ReachWaypoint",
    "Search",
    "Step",
]
