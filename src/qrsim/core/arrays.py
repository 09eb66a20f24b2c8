"""Names for types of NumPy arrays. Shapes and units are in the docstrings."""

from __future__ import annotations

from typing import Any

import numpy as np

NumpyArray = np.ndarray[Any, Any]
# Arrays of floating-point numbers, of either width.
Floats = np.ndarray[Any, Any]
# The type of an array's numbers.
DType = np.dtype[Any]
