"""How well the published constants reproduce the recorded flights, open loop (docs/explanation/paper.md).

The computation is ``qrsim validate``'s.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.errors import RunError
from qrsim.studies.validate import outdoor, rotation, thrust
from qrsim.studies.validate.recorded import FETCH, Match, command_rows

__all__ = ["DOC", "command_rows", "data_folder", "run"]

DOC = "mean squared errors of the identified quadrotor against the recorded rotation, thrust and outdoor runs"


def data_folder() -> Path:
    """Return the folder named by QRSIM_DATA_DIR.

    Raises:
        RunError: the variable is not set.
    """
    name = os.environ.get("QRSIM_DATA_DIR", "")
    if not name:
        raise RunError(f"no recordings: QRSIM_DATA_DIR is not set; {FETCH}")
    return Path(name)


def _errors(folder: Path, precision: str) -> tuple[dict[str, Any], dict[str, Match], outdoor.Outdoor]:
    """Return the mean squared errors of a precision, the recordings beside the simulation, and its outdoor flight."""
    turned = rotation.rotation_match(folder / rotation.RECORDING, precision)
    pushed = thrust.thrust_errors(folder / thrust.RECORDING, precision)
    flight = outdoor.fly_recorded(folder / outdoor.RECORDING, precision)
    matches = {"rotation": turned, "outdoor_velocity": outdoor.velocity_match(flight)}
    errors = {name: match.mean_square() for name, match in matches.items()} | {"thrust": pushed}
    return errors, matches, flight


def _scaled(matches: Mapping[str, Match], pushed: Mapping[str, float]) -> dict[str, Any]:
    """Return root mean squared errors and the standard deviations of the records, angles in degrees."""
    degrees = math.degrees(1.0)
    found: dict[str, Any] = {
        "thrust": {"rms": math.sqrt(pushed["mean_squared_error"]), "std": math.sqrt(pushed["record_variance"])}
    }
    for part, match in matches.items():
        scale = degrees if part == "rotation" else 1.0
        spread = np.std(match.recorded, axis=0).tolist()
        found[part] = {
            name: {"rms": scale * math.sqrt(error), "std": scale * spread[i]}
            for i, (name, error) in enumerate(match.mean_square().items())
        }
    return found


def run(full: bool, folder: Path | None = None) -> dict[str, Any]:
    """Return every error in float64; the full form adds those of a float32 run.

    Raises:
        RunError: no recordings.
    """
    folder = data_folder() if folder is None else folder
    results, matches, flight = _errors(folder, "float64")
    results["scaled"] = _scaled(matches, results["thrust"])
    results["specific_force"] = outdoor.specific_force_errors(flight)
    if full:
        results["float32"], _, _ = _errors(folder, "float32")
    return results
