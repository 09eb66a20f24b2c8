"""Control loops: from an estimate and a set-point to a vehicle's command (docs/explanation/models/control.md).

``setpoints.py`` has the set-points, ``controllers.py`` a controller for each kind of them, ``loops.py`` the parts that
controllers share, ``guidance.py`` the guidance of fleets without commands. Filters estimate a vehicle's state.
It may import ``models``, ``engine`` and the layers below them.
Read ``setpoints.py`` first.
"""

from qrsim.control.cascade import CascadeController
from qrsim.control.controllers import (
    AttitudeController,
    AttitudeHeightController,
    OffboardController,
    VelocityController,
    VelocityHeightController,
    WaypointController,
)
from qrsim.control.ekf import ErrorStateKalmanFilter
from qrsim.control.filter import ComplementaryFilter
from qrsim.control.fixed_wing import FixedWingController
from qrsim.control.flee import FleeGuidance
from qrsim.control.guidance import (
    AttitudeGuidance,
    AttitudeHeightGuidance,
    Route,
    RouteFollower,
    RouteState,
    VelocityGuidance,
    VelocityHeightGuidance,
)
from qrsim.control.loops import ClimbLoop, HeightLoop, HeightState, VelocityLoop, VelocityState
from qrsim.control.mission import Mission, MissionGuidance, MissionState
from qrsim.control.nothing import NoController, NoGuidance, NoSetpoint
from qrsim.control.rover import RoverController
from qrsim.control.setpoints import (
    SETPOINTS,
    AttitudeHeightSetpoint,
    AttitudeSetpoint,
    Estimate,
    OffboardSetpoint,
    PathSetpoint,
    Setpoint,
    TrackSetpoint,
    VelocityHeightSetpoint,
    VelocitySetpoint,
    WaypointSetpoint,
)
from qrsim.control.tracks import FixedWingGuidance, RoverGuidance

__all__ = [
    "SETPOINTS",
    "AttitudeController",
    "AttitudeGuidance",
    "AttitudeHeightController",
    "AttitudeHeightGuidance",
    "AttitudeHeightSetpoint",
    "AttitudeSetpoint",
    "CascadeController",
    "ClimbLoop",
    "ComplementaryFilter",
    "ErrorStateKalmanFilter",
    "Estimate",
    "FixedWingController",
    "FixedWingGuidance",
    "FleeGuidance",
    "HeightLoop",
    "HeightState",
    "Mission",
    "MissionGuidance",
    "MissionState",
    "NoController",
    "NoGuidance",
    "NoSetpoint",
    "OffboardController",
    "OffboardSetpoint",
    "PathSetpoint",
    "Route",
    "RouteFollower",
    "RouteState",
    "RoverController",
    "RoverGuidance",
    "Setpoint",
    "TrackSetpoint",
    "VelocityController",
    "VelocityGuidance",
    "VelocityHeightController",
    "VelocityHeightGuidance",
    "VelocityHeightSetpoint",
    "VelocityLoop",
    "VelocitySetpoint",
    "VelocityState",
    "WaypointController",
    "WaypointSetpoint",
]
