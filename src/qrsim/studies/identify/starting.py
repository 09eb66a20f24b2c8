"""Starting values: the published constants, or a vehicle identified before."""

from __future__ import annotations

from pathlib import Path

from qrsim.errors import UsageError
from qrsim.models.vehicles.separate_quadrotor import SeparateQuadrotor
from qrsim.scenarios.vehicle_file import read_vehicle_file
from qrsim.studies.identify.constants import CONSTANTS, PITCH, ROLL


def starting_values(path: Path | None, separate: bool) -> dict[str, float]:
    """Return constant -> initial value, published or from a vehicle file; ``separate``: pitch differs from roll.

    Args:
        path: of the vehicle file.
        separate: accept a file whose pitch constants differ from those of roll.

    Raises:
        UsageError: the file is no vehicle of this form.
    """
    published = SeparateQuadrotor()
    values = {name: float(getattr(published, name)) for name in CONSTANTS}
    if path is None:
        return values
    content = read_vehicle_file(path)
    if content.get("type") not in ("pelican", "quadrotor"):
        raise UsageError(f"{path}: a vehicle of type '{content.get('type')}'; expected pelican or quadrotor")
    if not separate and content["type"] == "quadrotor":
        raise UsageError(f"{path}: has separate pitch constants; add --separate")
    values |= {name: float(content[name]) for name in CONSTANTS if name in content}
    if content["type"] == "pelican":
        values |= {pitch: values[roll] for pitch, roll in zip(PITCH, ROLL, strict=True)}
    return values
