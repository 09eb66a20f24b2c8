"""Multirotors by their rotors: geometry, aerodynamics, contact, stabiliser and failures, one file each."""

from qrsim.models.vehicles.multirotor.commands import AttitudeCommand, MotorCommand, RateCommand
from qrsim.models.vehicles.multirotor.geometry import Rotor
from qrsim.models.vehicles.multirotor.vehicle import Multirotor

__all__ = ["AttitudeCommand", "MotorCommand", "Multirotor", "RateCommand", "Rotor"]
