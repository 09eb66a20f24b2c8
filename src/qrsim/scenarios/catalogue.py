"""Every component a scenario can name. A new component is one file in models/ and one line here."""

from __future__ import annotations

from typing import Any

from qrsim.control import (
    AttitudeController,
    AttitudeGuidance,
    AttitudeHeightController,
    AttitudeHeightGuidance,
    CascadeController,
    ComplementaryFilter,
    ErrorStateKalmanFilter,
    FixedWingController,
    FixedWingGuidance,
    FleeGuidance,
    MissionGuidance,
    NoController,
    NoGuidance,
    OffboardController,
    RouteFollower,
    RoverController,
    RoverGuidance,
    VelocityController,
    VelocityGuidance,
    VelocityHeightController,
    VelocityHeightGuidance,
    WaypointController,
)
from qrsim.control.teams import (
    AvoidanceGuidance,
    CoverageGuidance,
    FlockingGuidance,
    FormationGuidance,
    VicsekGuidance,
)
from qrsim.models.atmosphere.building_wakes import BuildingWakes
from qrsim.models.atmosphere.dryden import Dryden
from qrsim.models.atmosphere.field import DrydenField
from qrsim.models.atmosphere.gust import DiscreteGust, NoGust
from qrsim.models.atmosphere.ridge_lift import RidgeLift
from qrsim.models.atmosphere.thermals import Thermals
from qrsim.models.atmosphere.turbulence import DrydenFirstOrder, Still
from qrsim.models.atmosphere.wind import Calm, LogShear
from qrsim.models.atmosphere.wind_grid import WindGridFile
from qrsim.models.atmosphere.wind_profile import ProfileRows
from qrsim.models.atmosphere.wind_series import VeeringShear, WindFile
from qrsim.models.gnss.budget import ErrorBudget
from qrsim.models.gnss.constellations import NominalConstellations
from qrsim.models.gnss.errors import ConsumerErrors, GaussMarkov2, SurveyErrors
from qrsim.models.gnss.orbits import NominalConstellation
from qrsim.models.gnss.receivers import GnssReceiver, IdealGnss, OrnsteinUhlenbeckErrors
from qrsim.models.gnss.sensor import Gnss
from qrsim.models.gnss.sp3 import Sp3Ephemeris
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.elevation_file import ElevationFile
from qrsim.models.scene.fence import PolygonArea
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle
from qrsim.models.scene.persons import NoPersons, Persons
from qrsim.models.scene.placement import GivenPlaces, RingPlaces, UniformPlaces
from qrsim.models.scene.plume import DispersionPlume, GaussianPlume, NoPlume, PuffPlume
from qrsim.models.scene.prisms import PrismObstacle
from qrsim.models.scene.terrain import ClearGround, PatchyGround
from qrsim.models.scene.zones import ZonesArea
from qrsim.models.sensors.airspeed import Airspeed, IdealAirspeed
from qrsim.models.sensors.attitude import AttitudeEstimator, IdealAttitude
from qrsim.models.sensors.barometer import Barometer, IdealBarometer
from qrsim.models.sensors.camera import Camera, IdealCamera
from qrsim.models.sensors.concentration import ConcentrationSensor, IdealConcentration
from qrsim.models.sensors.imu import IdealImu, Imu
from qrsim.models.sensors.inertial import Accelerometer, Gyroscope, IdealAccelerometer, IdealGyroscope
from qrsim.models.sensors.magnetometer import IdealMagnetometer, Magnetometer
from qrsim.models.sensors.neighbours import IdealNeighbours, NeighbourSensor
from qrsim.models.sensors.optical_flow import IdealOpticalFlow, OpticalFlow
from qrsim.models.sensors.pressure import IdealPressureAltimeter, PressureAltimeter
from qrsim.models.sensors.rangefinder import IdealRangefinder, Rangefinder
from qrsim.models.sensors.ranging import IdealRanging, Ranging
from qrsim.models.sensors.scan import IdealScan, Scan
from qrsim.models.vehicles.battery import GivenVoltage, LithiumPolymer
from qrsim.models.vehicles.expression_quadrotor import ExpressionQuadrotor
from qrsim.models.vehicles.fixed_point import FixedPoint
from qrsim.models.vehicles.fixed_wing import FixedWing
from qrsim.models.vehicles.lithium_cells import LithiumCells
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.models.vehicles.rover import DifferentialRover, Rover
from qrsim.models.vehicles.separate_quadrotor import SeparateQuadrotor
from qrsim.tasks import (
    KeepFormation,
    KeepSpot,
    KeepVelocity,
    Land,
    NoTask,
    PlumeMapping,
    Pursuit,
    ReachWaypoint,
    Search,
)

Catalogue = dict[str, Any]

WINDS: Catalogue = {
    "calm": Calm,
    "log_shear": LogShear,
    "veering_shear": VeeringShear,
    "series": WindFile,
    "grid": WindGridFile,
    "profile": ProfileRows,
}
TURBULENCES: Catalogue = {
    "still": Still,
    "dryden_first_order": DrydenFirstOrder,
    "dryden": Dryden,
    "dryden_field": DrydenField,
}
GUSTS: Catalogue = {"none": NoGust, "discrete": DiscreteGust}
UPDRAFTS: Catalogue = {"thermals": Thermals, "ridge_lift": RidgeLift, "building_wakes": BuildingWakes}
ORBITS: Catalogue = {
    "nominal_constellation": NominalConstellation,
    "nominal_constellations": NominalConstellations,
    "sp3": Sp3Ephemeris,
}
SKY_ERRORS: Catalogue = {
    "ou": OrnsteinUhlenbeckErrors,
    "gauss_markov_2": GaussMarkov2,
    "consumer": ConsumerErrors,
    "survey": SurveyErrors,
    "error_budget": ErrorBudget,
}
OBSTACLES: Catalogue = {"box": BoxObstacle, "cylinder": CylinderObstacle, "prism": PrismObstacle}
AREAS: Catalogue = {"box": BoxArea, "polygon": PolygonArea, "zones": ZonesArea}
GROUNDS: Catalogue = {"flat": FlatGround, "dem": ElevationFile}
PLUMES: Catalogue = {
    "none": NoPlume,
    "gaussian": GaussianPlume,
    "dispersion": DispersionPlume,
    "puffs": PuffPlume,
}
TERRAINS: Catalogue = {"clear": ClearGround, "patches": PatchyGround}
PERSONS: Catalogue = {"none": NoPersons, "lying": Persons}
PLACEMENTS: Catalogue = {"given": GivenPlaces, "uniform": UniformPlaces, "ring": RingPlaces}
TASKS: Catalogue = {
    "none": NoTask,
    "keep_spot": KeepSpot,
    "reach_waypoint": ReachWaypoint,
    "land": Land,
    "keep_velocity": KeepVelocity,
    "keep_formation": KeepFormation,
    "pursuit": Pursuit,
    "search": Search,
    "plume_mapping": PlumeMapping,
}
VEHICLES: Catalogue = {
    "pelican": Quadrotor,
    "quadrotor": SeparateQuadrotor,
    "expression": ExpressionQuadrotor,
    "fixed_point": FixedPoint,
    "multirotor": Multirotor,
    "fixed_wing": FixedWing,
    "rover": Rover,
    "differential_rover": DifferentialRover,
}
BATTERIES: Catalogue = {"given": GivenVoltage, "lithium_polymer": LithiumPolymer, "lithium_cells": LithiumCells}
CONTROLLERS: Catalogue = {
    "waypoint": WaypointController,
    "velocity": VelocityController,
    "velocity_height": VelocityHeightController,
    "attitude_height": AttitudeHeightController,
    "attitude": AttitudeController,
    "offboard": OffboardController,
    "none": NoController,
    "cascade": CascadeController,
    "fixed_wing": FixedWingController,
    "rover": RoverController,
}
GUIDANCE: Catalogue = {
    "route": RouteFollower,
    "velocity": VelocityGuidance,
    "velocity_height": VelocityHeightGuidance,
    "attitude_height": AttitudeHeightGuidance,
    "attitude": AttitudeGuidance,
    "flee": FleeGuidance,
    "mission": MissionGuidance,
    "flocking": FlockingGuidance,
    "vicsek": VicsekGuidance,
    "formation": FormationGuidance,
    "coverage": CoverageGuidance,
    "orca": AvoidanceGuidance,
    "fixed_wing": FixedWingGuidance,
    "rover": RoverGuidance,
    "none": NoGuidance,
}
SENSORS: Catalogue = {
    "gnss_receiver": GnssReceiver,
    "gnss": Gnss,
    "ideal_gnss": IdealGnss,
    "barometer": Barometer,
    "ideal_barometer": IdealBarometer,
    "attitude_estimator": AttitudeEstimator,
    "ideal_attitude": IdealAttitude,
    "gyroscope": Gyroscope,
    "ideal_gyroscope": IdealGyroscope,
    "accelerometer": Accelerometer,
    "ideal_accelerometer": IdealAccelerometer,
    "imu": Imu,
    "ideal_imu": IdealImu,
    "pressure_altimeter": PressureAltimeter,
    "ideal_pressure_altimeter": IdealPressureAltimeter,
    "airspeed": Airspeed,
    "ideal_airspeed": IdealAirspeed,
    "magnetometer": Magnetometer,
    "ideal_magnetometer": IdealMagnetometer,
    "rangefinder": Rangefinder,
    "ideal_rangefinder": IdealRangefinder,
    "scan": Scan,
    "ideal_scan": IdealScan,
    "ranging": Ranging,
    "ideal_ranging": IdealRanging,
    "optical_flow": OpticalFlow,
    "ideal_optical_flow": IdealOpticalFlow,
    "neighbours": NeighbourSensor,
    "ideal_neighbours": IdealNeighbours,
    "concentration": ConcentrationSensor,
    "ideal_concentration": IdealConcentration,
    "camera": Camera,
    "ideal_camera": IdealCamera,
}
FILTERS: Catalogue = {"complementary": ComplementaryFilter, "ekf": ErrorStateKalmanFilter}
# What a scenario cannot name, but a command or a rollout can.
ESTIMATORS: Catalogue = {}
METRICS: Catalogue = {}

# Every kind of component that can come from outside (docs/howto/own_component.md); obstacles are gathered by their
# shapes.
KINDS: dict[str, Catalogue] = {
    "sensor": SENSORS,
    "vehicle": VEHICLES,
    "wind": WINDS,
    "turbulence": TURBULENCES,
    "gust": GUSTS,
    "updraft": UPDRAFTS,
    "sky": SKY_ERRORS,
    "orbits": ORBITS,
    "controller": CONTROLLERS,
    "guidance": GUIDANCE,
    "estimator": ESTIMATORS,
    "battery": BATTERIES,
    "area": AREAS,
    "ground": GROUNDS,
    "plume": PLUMES,
    "terrain": TERRAINS,
    "persons": PERSONS,
    "placement": PLACEMENTS,
    "task": TASKS,
    "metric": METRICS,
}
