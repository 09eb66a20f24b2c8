"""Control loops of the reference implementation, and the guidance that feeds them (docs/control.md).

``setpoints`` says what can be asked for, ``loops`` holds the parts that controllers share, ``controllers`` has one
record for each kind of set-point and one for all kinds, ``guidance`` what flies a fleet that nobody commands.
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
