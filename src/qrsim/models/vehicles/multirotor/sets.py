"""Published parameter sets of multirotors, each with its source."""

from __future__ import annotations

import math
from typing import Any

from qrsim.models.vehicles.multirotor.geometry import Rotor, ring, square_feet
from qrsim.models.vehicles.multirotor.stabiliser import Stabiliser
from qrsim.models.vehicles.multirotor.vehicle import Multirotor


def x500() -> Multirotor:
    """Return the X500 of PX4-gazebo-models (x500, x500_base); its body drag is assumed, as Gazebo has none."""
    return Multirotor()


def hummingbird() -> Multirotor:
    """Return the AscTec Hummingbird of rotorpy 3.0.0 as a multirotor, with rotor time constants from RotorS."""
    c = 0.17 / math.sqrt(2.0)
    return _multirotor(
        mass=0.5,
        inertia_x=3.65e-3,
        inertia_y=3.68e-3,
        inertia_z=7.03e-3,
        thrust_coefficient=5.57e-6,
        torque_ratio=1.36e-7 / 5.57e-6,
        speed_max=1500.0,
        spin_up=0.0125,
        spin_down=0.025,
        rotor_radius=0.10,
        rotor_drag=1.19e-4,
        inflow_loss=2.32e-4,
        translational_lift=3.39e-3,
        drag_x=0.005,
        drag_y=0.005,
        drag_z=0.01,
        nominal_voltage=11.1,
        top=(0.0, 0.0, -0.06),
        rotors=(Rotor((c, c, 0.0), -1), Rotor((-c, c, 0.0), 1), Rotor((-c, -c, 0.0), -1), Rotor((c, -c, 0.0), 1)),
        feet=square_feet(0.7 * c, 0.12),
    )


def hexa4() -> Multirotor:
    """Return a hexarotor of 4 kg with 15-inch propellers, an assumed design without a data sheet.

    Its figure of merit in hover is 0.65, and its motors with their controllers give 0.8 of the power of the battery.
    """
    return _multirotor(
        mass=4.0,
        inertia_x=0.12,
        inertia_y=0.12,
        inertia_z=0.21,
        thrust_coefficient=3.0e-5,
        torque_ratio=0.016,
        efficiency=0.8,
        speed_max=700.0,
        spin_up=0.03,
        spin_down=0.05,
        rotor_radius=0.1905,
        rotor_inertia=1.5e-4,
        rotor_drag=2.5e-4,
        inflow_loss=4.0e-4,
        drag_x=0.05,
        drag_y=0.05,
        drag_z=0.08,
        nominal_voltage=22.2,
        top=(0.0, 0.0, -0.15),
        rotors=ring(6, 0.35, math.pi / 6.0),
        feet=square_feet(0.2, 0.25),
    )


def pelican() -> Multirotor:
    """Return the AscTec Pelican of RotorS (pelican.xacro) as a multirotor, a rigid body with rotors.

    It weighs 1 kg there; the identified one (``type: pelican``) weighs 1.68 kg and has its own autopilot in it.
    """
    return _multirotor(
        mass=1.0,
        inertia_x=0.01,
        inertia_y=0.01,
        inertia_z=0.02,
        thrust_coefficient=9.9865e-6,
        torque_ratio=0.016,
        speed_max=838.0,
        spin_up=0.0125,
        spin_down=0.025,
        rotor_radius=0.128,
        rotor_drag=8.06428e-5,
        drag_x=0.0,
        drag_y=0.0,
        drag_z=0.0,
        nominal_voltage=11.1,
        top=(0.0, 0.0, -0.12),
        rotors=ring(4, 0.21, 0.0, direction=1, down=-0.05),
        feet=square_feet(0.1, 0.12),
    )


def crazyflie() -> Multirotor:
    """Return the Crazyflie 2.x with L250 propellers of drone-models 0.1.0 as a multirotor.

    Its thrust is fitted there by a quadratic with a linear term; here it is in proportion to the square of the speed,
    equal in hover (1986 rad/s) and at the largest thrust, 0.12 N a rotor. Drag after J. Foerster, "System
    identification of the Crazyflie 2.0 nano quadrocopter", ETH Zurich, 2015.
    """
    c = 0.046 / math.sqrt(2.0)
    return _multirotor(
        mass=0.0319,
        inertia_x=1.68e-5,
        inertia_y=1.68e-5,
        inertia_z=2.98e-5,
        thrust_coefficient=1.983e-8,
        torque_ratio=0.00735,
        speed_max=2460.0,
        spin_up=0.05,
        spin_down=0.1,
        rotor_radius=0.0231,
        rotor_drag=1.03e-6,
        inflow_loss=7.55e-7,
        drag_x=0.0,
        drag_y=0.0,
        drag_z=0.0,
        nominal_voltage=3.7,
        avionics_power=0.5,
        top=(0.0, 0.0, -0.02),
        rotors=(Rotor((c, c, 0.0), -1), Rotor((-c, c, 0.0), 1), Rotor((-c, -c, 0.0), -1), Rotor((c, -c, 0.0), 1)),
        feet=square_feet(0.7 * c, 0.015),
        # Its rotors are slow: at 8 rad/s it overshoots.
        stabiliser=_stabiliser(attitude_gain=6.0, rate_gain=18.0),
    )


SETS = {"x500": x500, "hummingbird": hummingbird, "pelican": pelican, "crazyflie": crazyflie, "hexa4": hexa4}


def _multirotor(**values: Any) -> Multirotor:
    """Return a multirotor with plain numbers as parameters; building a world makes them arrays."""
    return Multirotor(**values)


def _stabiliser(**gains: Any) -> Stabiliser:
    """Return an attitude stabiliser with these gains."""
    return Stabiliser(**gains)
