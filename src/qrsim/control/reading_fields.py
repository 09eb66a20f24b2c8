"""Fields of the readings of a fleet by name, from the first sensor that has them, for estimators."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp

from qrsim.core.tree import map_tree

# Fields of a magnetometer, body axes [uT], and of an airspeed sensor, along the body's x axis [m/s].
FIELD, AIRSPEED = "field_body", "true_airspeed"


def source_of(readings: Mapping[str, Any], field: str) -> str:
    """Return the name of the first sensor with ``field`` in its reading; "" without one."""
    return next((name for name, reading in readings.items() if field in reading.__dataclass_fields__), "")


def field_of(readings: Mapping[str, object], field: str) -> Any:
    """Return the value of ``field`` in the first reading that has it; None if no reading does."""
    name = source_of(readings, field)
    return getattr(readings[name], field) if name else None


def known(new: object, old: object) -> Any:
    """Return the record ``new`` of arrays (n,), with non-finite values replaced by those of ``old``."""
    return map_tree(lambda now, before: jnp.where(jnp.isfinite(now), now, before), new, old)
