"""How well the published constants reproduce the recorded flights, open loop (docs/models/vehicle.md).

The computation is ``qrsim validate``'s.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from qrsim.errors import RunError
from qrsim.studies.validate import outdoor, rotation, thrust
from qrsim.studies.validate.recorded import FETCH, command_rows

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


def _errors(folder: Path, precision: str) -> tuple[dict[str, Any], outdoor.Outdoor]:
    """Return the mean squared errors of a precision, and its outdoor flight."""
    turned = rotation.rotation_match(folder / rotation.RECORDING, precision)
    pushed = thrust.thrust_errors(folder / thrust.RECORDING, precision)
    flight = outdoor.fly_recorded(folder / outdoor.RECORDING, precision)
    errors = {
        "rotation": turned.mean_square(),
        "thrust": pushed,
        "outdoor_velocity": outdoor.velocity_match(flight).mean_square(),
    }
    return errors, flight


def run(full: bool, folder: Path | None = None) -> dict[str, Any]:
    """Return every mean squared error in float64; the full form adds those of a float32 run.

    Raises:
        RunError: no recordings.
    """
    folder = data_folder() if folder is None else folder
    results, flight = _errors(folder, "float64")
    results["specific_force"] = outdoor.specific_force_errors(flight)
    if full:
        results["float32"], _ = _errors(folder, "float32")
    return results
