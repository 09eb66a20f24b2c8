"""What is to be done in a world: actions -> set-points, reward, end, and what the agent sees. One file per family.

A task is a record with pure methods, like every component, and says

- ``fleet``: whose vehicles (n,) are the agents; ``period``: time between two actions;
- ``axes``: what an action consists of, with unit and range; an agent gives numbers in [-1, 1] for each;
- ``init(world, state, draw)``: what it remembers of an episode, where ``draw`` is its own randomness;
- ``commands(memory, world, action)``: from the actions (n, A) in their units to one action for each fleet;
- ``each_tick(memory, world, state)``: what every tick adds to the memory, where it adds anything;
- ``judge(memory, world, state, step, steps)``: the reward (n,) of a step while all fly, and the memory after it;
- ``observe(memory, world, state)``: what each agent sees, (n, O) or a dict of arrays (n, ...), never the truth.
"""

from qrsim.tasks.play import Episode, Play, Step
from qrsim.tasks.plume_mapping import PlumeMapping
from qrsim.tasks.pursuit import Pursuit
from qrsim.tasks.search import Search
from qrsim.tasks.simple import KeepSpot, KeepVelocity, NoTask, ReachWaypoint

__all__ = [
    "Episode",
    "KeepSpot",
    "KeepVelocity",
    "NoTask",
    "Play",
    "PlumeMapping",
    "Pursuit",
    "ReachWaypoint",
    "Search",
    "Step",
]
