"""A compiled tick that can be called, on quick code at first and on better code later."""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from time import perf_counter

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.engine.layout import Buffers, aligned
from qrsim.engine.llvm.background import compile_later
from qrsim.engine.llvm.compiler import Loaded
from qrsim.engine.llvm.entries import SEAT
from qrsim.engine.llvm.program import Binary, Input, Mode
from qrsim.engine.llvm.refusal import UnsupportedError, refusing

# How long quick code runs before better code is made: a tenth of what that takes.
PATIENCE_S = 0.3
TICKS_AT_ONCE = 1000
_ASKING = threading.Lock()
# Bytes of a seat before its memory: the words of SEAT, and on lines of the cache for themselves those that all change.
_ARRIVALS, _GIVEN_UP, _HEADER = 64, 128, 192


# Calls a function with the address of each seat, each in a thread.
OnSeats = Callable[[Callable[[int], None]], None]


@cache
def pause_address() -> int:
    """Return the address of the operating system's function that yields the processor, 0 if there is none."""
    with contextlib.suppress(OSError, AttributeError):
        posix = os.name == "posix"
        function = ctypes.CDLL(None).sched_yield if posix else ctypes.CDLL("kernel32").SwitchToThread
        return ctypes.cast(function, ctypes.c_void_p).value or 0
    return 0


def _at_seat(call: Callable[..., object], addresses: Sequence[int], arguments: Sequence[int], seat: int) -> None:
    """Call machine code with the addresses of buffers, of a thread's working memory (``seat``), and ``arguments``."""
    call(*addresses, seat, *arguments)


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
        self.local_bytes = binary.local_bytes
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
        """Load the machine code of this program, and call it from now on."""
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
        """Switch to faster machine code from the next call on, and cache it on disk."""
        # Code that cannot be loaded is not needed: the quick code goes on.
        with contextlib.suppress(UnsupportedError), refusing():
            self._load_code(code)
            self._quick = False
            if self._keep is not None:
                self._keep(Binary(code, self.scratch_bytes, local_bytes=self.local_bytes))

    def _ran(self, seconds: float) -> None:
        """Add running time [s]; request faster machine code once the program has run long enough."""
        self._patience_s -= seconds
        if self._patience_s <= 0.0 and self._text:
            # Several threads may run a program, and one of them asks.
            with _ASKING:
                text, self._text = self._text, b""
            if text:
                compile_later(text, self._better)

    @property
    def code_bytes(self) -> int:
        """Size [bytes] of the loaded machine code, and of the text of code that is still to be compiled."""
        return self._size + len(self._text)

    def scratch(self) -> NumpyArray:
        """Return working memory (bytes) for one thread."""
        if self.local_bytes:
            return self.seats(1)[0]
        return aligned(self.scratch_bytes, np.dtype(np.uint8))

    def seats(self, threads: int) -> list[NumpyArray]:
        """Return the working memory ("seat") of each thread; the first one also holds what the threads share."""
        sizes = [_HEADER + self.local_bytes + (0 if thread else self.scratch_bytes) for thread in range(threads)]
        seats = [aligned(size, np.dtype(np.uint8)) for size in sizes]
        first = seats[0].ctypes.data
        for thread, seat in enumerate(seats):
            begin = seat.ctypes.data
            words = {
                "scratch": first + _HEADER + self.local_bytes,
                "local": begin + _HEADER,
                "thread": thread,
                "threads": threads,
                "arrivals": first + _ARRIVALS,
                "given_up": first + _GIVEN_UP,
                "pause": pause_address(),
            }
            seat[: 8 * len(SEAT)].view(np.uint64)[:] = [words[name] for name in SEAT]
        return seats

    @staticmethod
    def give_up(seats: Sequence[NumpyArray]) -> None:
        """Release threads that wait at a barrier for others that never come; the seats are then unusable."""
        seats[0][_GIVEN_UP : _GIVEN_UP + 8].view(np.uint64)[:] = 1

    def buffers(self, which: int) -> Buffers:
        """Return new float and integer buffers of input number ``which``, for all lanes or one shared copy."""
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

    def together(self, run: OnSeats, addresses: Sequence[int], tick: int, count: int) -> None:
        """Advance a state by ``count`` ticks with several threads; ``run`` calls a function for each thread.

        Args:
            run: calls a function with the address of each seat, each in a thread.
            addresses: of the buffers of all inputs in order.
            tick: the first one.
            count: ticks.
        """
        for first, ticks in self._portions(count):
            # One code for all of them: it may be replaced at any time.
            run(partial(_at_seat, self._call, addresses, (tick + first, ticks)))

    def keeping_together(self, run: OnSeats, addresses: Sequence[int], tick: int, rows: Buffers) -> None:
        """Advance one world by a tick per row with several threads (called by ``run``); write each state to its row."""
        for first, ticks in self._portions(len(rows[0])):
            to = (number for part in rows for number in (part[first:].ctypes.data, part.strides[0]))
            run(partial(_at_seat, self._call_keeping, addresses, (tick + first, ticks, *to)))

    def keeping(self, addresses: Sequence[int], scratch: int, tick: int, rows: Buffers) -> None:
        """Advance one world by as many ticks as ``rows`` has rows, and write its state after each tick to a row.

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
        """Split ``count`` ticks into calls; yield the first tick and number of ticks of each, few for quick code."""
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
        """Advance the worlds of each row of a table of buffer addresses, uint64 (rows, 2 per input), contiguous."""
        begin = perf_counter()
        self._call_each(table.ctypes.data, len(table), scratch, tick, count)
        if self._quick:
            self._ran(perf_counter() - begin)
