"""The airspeed at which a multirotor that leans stays where it is."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.vehicles.multirotor.parameters import Airframe

# Nothing of this kind is that fast [m/s].
FASTEST = 100.0
HALVINGS = 40


def leaning(vehicle: Airframe, tilt: object) -> tuple[Floats, Floats] | None:
    """Return airspeed [m/s] and thrust [N] (n,) of steady flight at a tilt (n,) [rad]; None for tilted rotors.

    Leaning by theta into a steady wind V with N rotors at a speed W, of a thrust T each,
    m g sin(theta) = (N k_d W + c_x V) V cos(theta), and N T = m g cos(theta) + c_z V^2 sin(theta), where
    T = k_T W^2 - k_z W V sin(theta) + k_h (V cos(theta))^2. The thrust is that of these rotor speeds in still air.
    The density is that at the site.
    """
    if any(rotor.axis != (0.0, 0.0, -1.0) for rotor in vehicle.rotors):
        return None
    names = (
        "mass",
        "gravity",
        "thrust_coefficient",
        "rotor_drag",
        "inflow_loss",
        "translational_lift",
        "drag_x",
        "drag_z",
    )
    of = vehicle.in_density(vehicle.site_share)
    values = [np.asarray(getattr(of, name), np.float64) for name in names]
    mass, gravity, k_t, k_d, k_z, k_h, c_x, c_z = values
    lean, count, weight = np.asarray(tilt, np.float64), len(vehicle.rotors), mass * gravity
    sine, cosine = np.sin(lean), np.cos(lean)

    def speed(wind: Floats) -> Floats:
        """Return the rotor speed (n,) [rad/s] with which the weight is carried in a wind (n,) [m/s]."""
        wanted = (weight * cosine + c_z * wind * wind * sine) / count - k_h * (wind * cosine) ** 2
        loss = k_z * wind * sine
        return (loss + np.sqrt(loss * loss + 4.0 * k_t * np.maximum(wanted, 0.0))) / (2.0 * k_t)

    low = np.zeros(np.broadcast(lean, weight).shape)
    high = np.full_like(low, FASTEST)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        blown = (count * k_d * speed(middle) + c_x * middle) * middle * cosine > weight * sine
        low, high = np.where(blown, low, middle), np.where(blown, middle, high)
    airspeed = np.where(high < FASTEST, low, np.inf)
    return airspeed, count * k_t * speed(low) ** 2
