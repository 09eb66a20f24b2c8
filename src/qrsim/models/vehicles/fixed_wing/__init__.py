"""Fixed wings by their aerodynamic coefficients: air data, forces, propeller, stabiliser and trim, one file each."""

from qrsim.models.vehicles.fixed_wing.commands import AttitudeCommand, SurfaceCommand
from qrsim.models.vehicles.fixed_wing.trim import Trim, modes, trim
from qrsim.models.vehicles.fixed_wing.vehicle import FixedWing

__all__ = ["AttitudeCommand", "FixedWing", "SurfaceCommand", "Trim", "modes", "trim"]
