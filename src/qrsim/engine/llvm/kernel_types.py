"""Names and types of the functions that kernels become."""

from __future__ import annotations

import numpy as np

from qrsim.core.primitives import KERNELS
from qrsim.engine.llvm.text import scalar_type, vector


def symbol(name: str, lanes: int) -> str:
    """Return the symbol of a kernel for vectors of ``lanes`` elements."""
    return f"@kernel.{name}.{lanes}"


def types(names: tuple[str, ...], lanes: int) -> list[str]:
    """Return LLVM's types of vectors."""
    return [vector(scalar_type(np.dtype(name)), lanes) for name in names]


def result_type(name: str, lanes: int) -> str:
    """Return LLVM's type of all results of a kernel together."""
    return "{ " + ", ".join(types(KERNELS[name].gives, lanes)) + " }"
