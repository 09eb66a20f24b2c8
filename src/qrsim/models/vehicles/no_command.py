"""The command of vehicles that take none."""

from __future__ import annotations

from qrsim.core.tree import record


@record
class NoCommand:
    """A record without fields."""
