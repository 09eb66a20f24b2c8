"""Range-only SLAM on recorded flights, and the consistency of its covariances (docs/explanation/slam.md).

One vehicle or several, with GNSS errors taken as white or as coloured.
It may import ``flight_logs``, and the layers below ``studies``.
Read ``estimate.py`` first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from qrsim.studies.slam.cooperative import CooperativeSlam
    from qrsim.studies.slam.estimate import Slam, from_run
    from qrsim.studies.slam.team_run import cooperative_from_run

__all__ = ["CooperativeSlam", "Slam", "cooperative_from_run", "from_run"]
# Where each is.
_MODULES = {
    "CooperativeSlam": "cooperative",
    "Slam": "estimate",
    "cooperative_from_run": "team_run",
    "from_run": "estimate",
}


def __getattr__(name: str) -> object:
    # Imported on first use: the command's help needs none of it.
    if name in _MODULES:
        from importlib import import_module

        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
