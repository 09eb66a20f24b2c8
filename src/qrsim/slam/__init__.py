"""Range-only SLAM on recorded flights, and how consistent it is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from qrsim.slam.estimate import Slam, from_run

__all__ = ["Slam", "from_run"]


def __getattr__(name: str) -> Any:
    # Imported on first use: the command's help needs none of it.
    if name in __all__:
        from qrsim.slam import estimate

        return getattr(estimate, name)
    raise AttributeError(f"module 'qrsim.slam' has no attribute '{name}'")
