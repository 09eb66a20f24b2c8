"""Rovers on wheels: steered at the front, or by two sides that turn at different speeds."""

from qrsim.models.vehicles.rover.ackermann import Rover
from qrsim.models.vehicles.rover.commands import DriveCommand, SteeringCommand, WheelCommand
from qrsim.models.vehicles.rover.differential import DifferentialRover

__all__ = ["DifferentialRover", "DriveCommand", "Rover", "SteeringCommand", "WheelCommand"]
