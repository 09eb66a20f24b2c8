"""Guidance of teams: velocities from the neighbour list of each vehicle (docs/explanation/models/teams.md).

``mates`` makes the neighbour lists; each behaviour is one file with its literature.
"""

from qrsim.control.teams.avoidance import AvoidanceGuidance
from qrsim.control.teams.coverage import CoverageGuidance
from qrsim.control.teams.flocking import FlockingGuidance
from qrsim.control.teams.formation import FormationGuidance
from qrsim.control.teams.mates import Mates, TeamGuidance, mates_heard, mates_of, mates_wanted
from qrsim.control.teams.vicsek import VicsekGuidance

__all__ = [
    "AvoidanceGuidance",
    "CoverageGuidance",
    "FlockingGuidance",
    "FormationGuidance",
    "Mates",
    "TeamGuidance",
    "VicsekGuidance",
    "mates_heard",
    "mates_of",
    "mates_wanted",
]
