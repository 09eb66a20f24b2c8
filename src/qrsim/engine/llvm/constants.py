"""Arrays of constants in a program, side by side in one block of memory."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.engine.llvm.text import literal, stored_bytes, stored_type

# Bytes that the beginning of an array is aligned to.
_ALIGN = 64


class Constants:
    """Takes arrays, and writes them as one constant of the module."""

    # LLVM cannot see where the pointer comes from, so an element is read by one instruction with an offset from it. It
    # would otherwise load a far address first, for each element.
    pointer = "%constants"
    entry = f'  {pointer} = call ptr asm "", "=r,0"(ptr @constants)'

    def __init__(self) -> None:
        self._types: list[str] = []
        self._values: list[str] = []
        self._size = 0

    def add(self, array: NumpyArray, behind: int) -> int:
        """Store a constant array in row-major order, followed by ``behind`` zeros; return its offset [bytes]."""
        offset, element = self._size, stored_type(array.dtype)
        # As bools lie in memory everywhere else.
        stored = array.astype(np.int32) if array.dtype.kind == "b" else array
        flat = np.concatenate([stored.ravel(), np.zeros(behind, stored.dtype)])
        self._append(f"[{flat.size} x {element}]", ", ".join(f"{element} {literal(v, flat.dtype)}" for v in flat))
        self._size += flat.size * stored_bytes(array.dtype)
        if gap := -self._size % _ALIGN:
            self._append(f"[{gap} x i8]", ", ".join(["i8 0"] * gap))
            self._size += gap
        return offset

    def _append(self, kind: str, values: str) -> None:
        """Append an array to the constants, given its LLVM type and its values as LLVM text."""
        self._types.append(kind)
        self._values.append(f"{kind} [{values}]")

    def text(self) -> str:
        """Return the LLVM definition of the global that holds all constant arrays."""
        types, values = ", ".join(self._types), ", ".join(self._values)
        return f"@constants = private constant <{{ {types} }}> <{{ {values} }}>, align {_ALIGN}"
