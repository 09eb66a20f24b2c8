"""How LLVM writes types and numbers."""

from __future__ import annotations

import math
import struct
from functools import cache

import numpy as np

from qrsim.core.arrays import DType
from qrsim.engine.llvm.refusal import UnsupportedError

_SCALAR = {"float32": "float", "float64": "double", "int32": "i32", "uint32": "i32", "int64": "i64", "uint64": "i64"}


@cache
def scalar_type(dtype: DType) -> str:
    """Return the LLVM type of one element in a register, such as "float".

    Raises:
        UnsupportedError: there are no such numbers here.
    """
    if dtype.kind == "b":
        return "i1"
    if dtype.name not in _SCALAR:
        raise UnsupportedError(f"numbers of type {dtype}")
    return _SCALAR[dtype.name]


def stored_type(dtype: DType) -> str:
    """Return the LLVM type of one element in memory: i32 for a bool."""
    # A vector of i1 has no place of its own for each lane in memory.
    return "i32" if dtype.kind == "b" else scalar_type(dtype)


def stored_bytes(dtype: DType) -> int:
    """Return the size [bytes] of one element in memory."""
    return 4 if dtype.kind == "b" else dtype.itemsize


def vector(element: str, lanes: int) -> str:
    """Return the LLVM type of a vector of ``lanes`` elements, or the element's type for one lane."""
    return element if lanes == 1 else f"<{lanes} x {element}>"


def literal(value: float | np.float32, dtype: DType) -> str:
    """Return a number as an LLVM literal of this dtype."""
    if dtype.kind == "b":
        return "true" if value else "false"
    if dtype.kind == "f":
        # In hexadecimal, because LLVM refuses a decimal that is not exact; a float too is written as a double.
        return f"0x{struct.unpack('>Q', struct.pack('>d', float(value)))[0]:016X}"
    return str(int(value))


def splat(text: str, element: str, lanes: int) -> str:
    """Return an LLVM constant that repeats the literal ``text``, of LLVM type ``element``, in all lanes."""
    # LLVM writes constants of vectors so; a list of sixteen would make texts several times as long.
    return text if lanes == 1 else f"splat ({element} {text})"


def suffix(element: str, lanes: int) -> str:
    """Return the suffix of an LLVM intrinsic's name for vectors of ``element``, such as "v8f32"."""
    letter = {"float": "f32", "double": "f64"}.get(element, element)
    return letter if lanes == 1 else f"v{lanes}{letter}"


def neutral(how: str, dtype: DType) -> str:
    """Return the initial value of the reduction ``how``, such as 0 for a sum, as an LLVM literal."""
    if how in ("add", "or"):
        return literal(0, dtype)
    if how == "mul":
        return literal(1, dtype)
    if how == "and":
        return literal(True, dtype) if dtype.kind == "b" else "-1"
    if dtype.kind == "f":
        return literal(math.inf if how == "min" else -math.inf, dtype)
    if dtype.kind == "b":
        return literal(how == "min", dtype)
    limits = np.iinfo(dtype)
    return str(limits.max if how == "min" else limits.min)
