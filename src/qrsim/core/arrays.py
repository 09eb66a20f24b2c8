"""Names for types of NumPy arrays, whose shapes and units are in the docstrings, and a check of numbers."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np

NumpyArray = np.ndarray[Any, Any]
# Arrays of floating-point numbers, of either width.
Floats = np.ndarray[Any, Any]
# The type of an array's numbers.
DType = np.dtype[Any]


def is_number(value: Any) -> bool:
    """Return whether a value is a real number (Python's or NumPy's) of magnitude below 1e300; False for a bool."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    size: Any = abs(value.item() if isinstance(value, np.generic) else value)
    return not size >= 1e300
