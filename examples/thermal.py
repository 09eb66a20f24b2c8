"""A fixed wing climbs in a thermal with its motor off.

``python examples/thermal.py`` flies ten minutes and prints the height. The wing circles, and centres itself
by its variometer alone: it turns less while the climb grows and more while it fades (K. Andersson, I. Kaminer,
V. Dobrokhodov, V. Cichella, "Thermal Centering Control for Autonomous Soaring", J. Guidance 35(3), 2012).
"""

import numpy as np

import qrsim
from qrsim.models.vehicles.fixed_wing import AttitudeCommand

AIRSPEED, BANK, GAIN, PERIOD = 18.0, np.radians(33.0), 0.8, 0.1
# A propeller that stands still would brake as much as the wing, so it is folded away.
FOLDED = {"diameter": 0.02}
SCENARIO = {
    "area": {"type": "box", "x_min": -2000, "x_max": 2000, "y_min": -2000, "y_max": 2000, "z_min": -1600},
    "wind": {"type": "log_shear", "speed_20ft": 1.5, "wind_from_deg": 250},
    "updrafts": [{"type": "thermals", "w_star": 4.0, "z_i": 2000.0, "places_ned": [[0, 0]]}],
    "vehicle": {"type": "fixed_wing", "longitudinal": {"drag_parasitic": 0.0437}, "propeller": FOLDED},
    "controller": {"type": "fixed_wing", "feed": "truth"},
    "sensors": {"height": {"type": "ideal_barometer"}, "air": {"type": "ideal_airspeed"}},
    "vehicles": [{"position_ned": [-60, -30, -300], "velocity_body": [AIRSPEED, 0, 0]}],
}


def glide(seconds: float = 600.0, centres: bool = True, **parts: object) -> dict[str, np.ndarray]:
    """Return time [s], position NED [m], climb of the energy height [m/s] and velocity of the air [m/s] of a glide."""
    sim = qrsim.Simulation(qrsim.make_world(duration=seconds, **{**SCENARIO, **parts}), seed=1)
    reading, climb, last = sim.reset(), 0.0, None
    rows = []
    while sim.time < seconds and sim.valid.all():
        speed = reading.air.true_airspeed
        energy = reading.height.height + speed**2 / (2.0 * 9.81)
        before, climb = climb, climb + (0.0 if last is None else PERIOD / 2.0 * ((energy - last) / PERIOD - climb))
        last, growth = energy, (climb - before) / PERIOD
        roll = np.clip(BANK - (GAIN * growth if centres else 0.0), np.radians(15.0), np.radians(50.0))
        pitch = np.clip(0.05 + 0.03 * (speed - AIRSPEED), -0.3, 0.3)
        reading = sim.step(AttitudeCommand(roll + 0.0 * speed, pitch, 0.0 * speed), ticks=round(PERIOD / 0.02))
        rows.append((sim.time, *sim.truth.position_ned[0], float(np.ravel(climb)[0]), *sim.truth.wind_ned[0]))
    time, *columns = np.array(rows).T
    return {"time": time, "position": np.array(columns[:3]).T, "climb": columns[3], "wind": np.array(columns[4:]).T}


if __name__ == "__main__":
    flown = glide()
    height = -flown["position"][:, 2]
    print(f"{flown['time'][-1]:.0f} s with the motor off: from {height[0]:.0f} m to {height[-1]:.0f} m")
