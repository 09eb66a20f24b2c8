"""A compiled tick that can be called, on quick code at first and on better code later."""

from __future__ import annotations

import contextlib
import ctypes
import threading
from collections.abc import Callable, Iterator, Sequence
from time import perf_counter

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.engine.layout import Buffers, aligned
from qrsim.engine.llvm.background import compile_later
from qrsim.engine.llvm.compiler import Loaded
from qrsim.engine.llvm.program import Binary, Input, Mode
from qrsim.engine.llvm.refusal import UnsupportedError, refusing

# How long quick code runs before better code is made: a tenth of what that takes.
PATIENCE_S = 0.3
TICKS_AT_ONCE = 1000
_ASKING = threading.Lock()


class Program:
    """A compiled tick that can be called.

    Args:
        binary: what ``build`` returned.
        inputs, mode: what it was built for.
        keep: takes the better code of a program, where it is made while the program runs.
    """

    def __init__(
        self, binary: Binary, inputs: Sequence[Input], mode: Mode, keep: Callable[[Binary], None] | None = None
    ):
        self.inputs, self.mode, self.scratch_bytes = tuple(inputs), mode, binary.scratch_bytes
        self._keep = keep
        # Text of better code, until that is asked for, and the seconds until then.
        self._text, self._patience_s = binary.text, PATIENCE_S
        self._quick = bool(binary.text)
        # Every one that was loaded, because an address is valid as long as its code is in memory, and a thread may be
        # in the code that is replaced.
        self._loaded: list[Loaded] = []
        self._size = 0
        self._load_code(binary.code)

    def _load_code(self, code: bytes) -> None:
        """Load machine code, and call it from now on."""
        loaded = Loaded(code)
        self._loaded.append(loaded)
        self._size += len(code)
        # Called without the lock of Python, so threads run their worlds at the same time.
        pointers = [ctypes.c_void_p] * (2 * len(self.inputs) + 1)
        prototype = ctypes.CFUNCTYPE(None, *pointers, ctypes.c_int32, ctypes.c_int32)
        self._call = prototype(loaded.address("advance"))
        rows = [ctypes.c_void_p, ctypes.c_int64] * 2
        prototype = ctypes.CFUNCTYPE(None, *pointers, ctypes.c_int32, ctypes.c_int32, *rows)
        self._call_keeping = prototype(loaded.address("advance_keeping"))
        prototype = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p, *[ctypes.c_int32] * 2)
        self._call_each = prototype(loaded.address("advance_each"))

    def _better(self, code: bytes) -> None:
        """Use better code from the next call on, and have it kept."""
        # Code that cannot be loaded is not needed: the quick code goes on.
        with contextlib.suppress(UnsupportedError), refusing():
            self._load_code(code)
            self._quick = False
            if self._keep is not None:
                self._keep(Binary(code, self.scratch_bytes))

    def _ran(self, seconds: float) -> None:
        """Ask for better code once the program has run for long enough to pay for it."""
        self._patience_s -= seconds
        if self._patience_s <= 0.0 and self._text:
            # Several threads may run a program, and one of them asks.
            with _ASKING:
                text, self._text = self._text, b""
            if text:
                compile_later(text, self._better)

    @property
    def code_bytes(self) -> int:
        """Size of all code that is loaded, and of the text of better code."""
        return self._size + len(self._text)

    def scratch(self) -> NumpyArray:
        """Return working memory for one thread."""
        return aligned(self.scratch_bytes, np.dtype(np.uint8))

    def buffers(self, which: int) -> Buffers:
        """Return empty buffers of an input: of its floats and of its integers, for all lanes where it is own."""
        layout = self.inputs[which].layout
        # What all share is read once and spread over the lanes.
        width = self.mode.worlds if self.inputs[which].own else 1
        floats, integers = (
            aligned(size * width, np.dtype(dtype))
            for size, dtype in zip(layout.sizes, (layout.dtype, np.int32), strict=True)
        )
        return floats, integers

    def __call__(self, addresses: Sequence[int], scratch: int, tick: int, count: int) -> None:
        """Advance the state by ``count`` ticks, from addresses of the buffers of all inputs in order."""
        for first, ticks in self._portions(count):
            self._call(*addresses, scratch, tick + first, ticks)

    def keeping(self, addresses: Sequence[int], scratch: int, tick: int, rows: Buffers) -> None:
        """Advance one world by as many ticks as there are rows, and write its state after each tick to the next row.

        Args:
            addresses: of the buffers of all inputs in order.
            scratch: address of working memory.
            tick: the first one.
            rows: floats and integers, each (ticks, size) and contiguous.
        """
        for first, ticks in self._portions(len(rows[0])):
            to = [number for part in rows for number in (part[first:].ctypes.data, part.strides[0])]
            self._call_keeping(*addresses, scratch, tick + first, ticks, *to)

    def _portions(self, count: int) -> Iterator[tuple[int, int]]:
        """Yield ticks as (first, how many), which the caller runs; quick code gets few at once."""
        first = 0
        while self._quick and first < count:
            # Few enough that better code is used from the middle of a long call on.
            ticks, begin = min(count - first, TICKS_AT_ONCE), perf_counter()
            yield first, ticks
            self._ran(perf_counter() - begin)
            first += ticks
        if first < count:
            yield first, count - first

    def each(self, table: NumpyArray, scratch: int, tick: int, count: int) -> None:
        """Do so for each row of a table of addresses, (rows, two for each input) uint64 and contiguous."""
        begin = perf_counter()
        self._call_each(table.ctypes.data, len(table), scratch, tick, count)
        if self._quick:
            self._ran(perf_counter() - begin)
