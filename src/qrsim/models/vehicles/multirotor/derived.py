"""Quantities derived from the parameters of a multirotor: hover and reserves."""

from __future__ import annotations

import math

import numpy as np

from qrsim.models.vehicles.multirotor.vehicle import Multirotor


def derived(vehicle: Multirotor) -> dict[str, float]:
    """Return derived quantities of a multirotor, {name with unit: value}; of the first vehicle if several.

    Hover is in the air of the site, the coefficients are those of the vehicle.
    """
    one = _first(vehicle)
    weight = one["mass"] * one["gravity"]
    count = len(vehicle.rotors)
    share = float(np.ravel(vehicle.site_share)[0])
    coefficient = one["thrust_coefficient"] * share
    most = coefficient * one["speed_max"] ** 2 * vehicle.lift_share
    return {
        "mass_kg": one["mass"],
        "inertia_x_kg_m2": one["inertia_x"],
        "inertia_y_kg_m2": one["inertia_y"],
        "inertia_z_kg_m2": one["inertia_z"],
        "rotors": count,
        "rotor_radius_m": one["rotor_radius"],
        "k_t_n_s2": one["thrust_coefficient"],
        "k_q_n_m_s2": one["thrust_coefficient"] * one["torque_ratio"],
        "speed_max_rad_s": one["speed_max"],
        "tip_speed_max_m_s": one["speed_max"] * one["rotor_radius"],
        "air_density_kg_m3": share * one["air_density"],
        "hover_speed_rad_s": math.sqrt(weight / (coefficient * vehicle.lift_share)),
        "hover_throttle": _throttle(one["throttle_curve"], weight / most),
        "thrust_to_weight": most / weight,
        "spin_up_s": one["spin_up"],
        "spin_down_s": one["spin_down"],
        "roll_time_constant_s": 1.0 / float(np.ravel(vehicle.stabiliser.attitude_gain)[0]),
    }


def _throttle(a: float, share: float) -> float:
    """Return the throttle u at which a u^2 + (1 - a) u equals ``share``, thrust over largest thrust."""
    return 2.0 * share / ((1.0 - a) + math.sqrt((1.0 - a) ** 2 + 4.0 * a * share))


def _first(vehicle: Multirotor) -> dict[str, float]:
    """Return the first vehicle's parameters as plain floats by name."""
    values = {name: value for name, value in vars(vehicle).items() if isinstance(value, int | float | np.ndarray)}
    return {name: float(np.ravel(value)[0]) for name, value in values.items()}
