"""What the sensors ``pressure_altimeter`` and ``airspeed`` err by in flight, error by error.

Vehicles on the default patrol, which face north, in 8 m/s from there. Each carries an altimeter for each error, which
has that error alone, and one that has them all; and a pitot tube of each preset, whose true airspeed is compared with
that of an ideal one wherever it says any.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

import qrsim
from evidence import IMAGES
from evidence._pictures import picture
from qrsim.models.sensors.air_presets import AIRSPEEDS

DOC = "errors of pressure altimeter and airspeed on a patrol in wind"
SEED = 20261122
Floats = npt.NDArray[np.float64]
# The parameters of each error.
ERRORS = {
    "noise": ("noise_std",),
    "weather": ("drift_std",),
    "wind": ("port_forward", "port_backward", "port_right", "port_left"),
    "rotors": ("rotor_wash", "ground_effect"),
}
PERIOD_S = 0.5
WIND = ["world.wind.speed_20ft=8.0", "world.wind.wind_from_deg=0.0"]


def sensors() -> dict[str, dict[str, Any]]:
    """Return an altimeter for each error, one with all, and pitot tubes."""
    every = [name for names in ERRORS.values() for name in names]
    found: dict[str, dict[str, Any]] = {"all": {"type": "pressure_altimeter"}}
    for error, own in ERRORS.items():
        found[error] = {"type": "pressure_altimeter", **{name: 0.0 for name in every if name not in own}}
    found |= {name: {"type": "airspeed", "preset": name} for name in AIRSPEEDS}
    return found | {"truth": {"type": "ideal_airspeed"}}


def flown(flights: int, seconds: float) -> dict[str, Floats]:
    """Return the errors (flights, times, vehicles) of heights [m] and true airspeeds [m/s], NaN where none was said."""
    changes = [
        f"fleets.pelicans.sensors.{name}={{{', '.join(f'{key}: {value}' for key, value in each.items())}}}"
        for name, each in sensors().items()
    ]
    simulation = qrsim.Simulation(qrsim.load_scenario("patrol_plain", WIND + changes).world())
    ticks = round(PERIOD_S / simulation.world.time_step)
    seen: dict[str, list[list[Any]]] = {}
    for flight in range(flights):
        simulation.reset(seed=SEED + flight)
        for rows in seen.values():
            rows.append([])
        for _ in range(round(seconds / PERIOD_S)):
            reading, height = simulation.step(ticks=ticks), -simulation.truth.position_ned[:, 2]
            now = {name: getattr(reading, name).height - height for name in ("all", *ERRORS)}
            now |= {name: getattr(reading, name).true_airspeed - reading.truth.true_airspeed for name in AIRSPEEDS}
            for name, row in now.items():
                seen.setdefault(name, [[]])[-1].append(row)
    return {name: np.array(rows, np.float64) for name, rows in seen.items()}


def draw(errors: dict[str, Floats]) -> None:
    """Write docs/images/pressure_altimeter.png: the errors of one vehicle's heights over a flight."""
    with picture(IMAGES / "pressure_altimeter.png", (7.0, 3.2)) as axes:
        time = PERIOD_S * np.arange(1, errors["all"].shape[1] + 1)
        for name in ("all", *ERRORS):
            axes.plot(time, errors[name][0, :, 0], label=name, linewidth=1.6 if name == "all" else 0.9)
        axes.set(xlabel="time [s]", ylabel="height error [m]")
        axes.legend(fontsize=7, ncols=5)


def run(full: bool) -> dict[str, Any]:
    """Return mean and standard deviation of each error of the height, and how airspeeds err; full: 40 flights."""
    flights, seconds = (40, 60.0) if full else (2, 5.0)
    errors = flown(flights, seconds)
    if full:
        draw(errors)
    heights = {
        name: {"mean": float(np.nanmean(errors[name])), "std": float(np.nanstd(errors[name]))}
        for name in ("all", *ERRORS)
    }
    speeds = {}
    for name in AIRSPEEDS:
        said = errors[name][np.isfinite(errors[name])]
        speeds[name] = {
            "said": float(np.mean(np.isfinite(errors[name]))),
            "rms": float(np.sqrt(np.mean(said**2))) if len(said) else 0.0,
        }
    return {"flights": flights, "seconds": seconds, "height": heights, "airspeed": speeds}
