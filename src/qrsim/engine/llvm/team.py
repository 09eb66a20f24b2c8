"""Threads that run one world together, as long as that is faster than one thread."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from time import perf_counter

from qrsim.engine.layout import Buffers
from qrsim.engine.llvm.calling import Program

# Least numbers of a state for each thread, and least numbers of all ticks of a call, for several threads.
NUMBERS_OF_A_THREAD, NUMBERS_OF_A_CALL = 1 << 16, 1 << 18
# Time between two choices of the faster way [s], and how many choices there are for each trial of the slower way.
_STRETCH_S, _TRIED_AGAIN = 0.03, 32
_POOLS: dict[int, ThreadPoolExecutor] = {}
# Held while threads run one world together: two worlds at once could each wait for threads that the other one has.
_BUSY = threading.Lock()


def _forget_threads() -> None:
    """Drop the threads of the parent process; called in a child process after a fork."""
    global _BUSY
    _POOLS.clear()
    _BUSY = threading.Lock()


if hasattr(os, "register_at_fork"):
    # A process that is forked off has none of the threads.
    os.register_at_fork(after_in_child=_forget_threads)


def worker_pool(workers: int) -> ThreadPoolExecutor:
    """Return the process's thread pool with this number of workers, created once."""
    if workers not in _POOLS:
        _POOLS[workers] = ThreadPoolExecutor(workers, thread_name_prefix="qrsim-worlds")
    return _POOLS[workers]


class Pace:
    """Which of two ways is faster, alone or together: both are measured, because other processes use the cores too."""

    def __init__(self) -> None:
        self._seconds: dict[bool, float] = {}
        self._turn = 0

    def together(self) -> bool:
        """Choose for the next ticks: several threads (True) or one; the faster way, and sometimes the other one."""
        for way in (True, False):
            if way not in self._seconds:
                return way
        self._turn += 1
        faster = self._seconds[True] <= self._seconds[False]
        return faster == (self._turn % _TRIED_AGAIN != 0)

    def took(self, together: bool, seconds: float) -> None:
        """Record how long [s] a tick took, with several threads (``together``) or one."""
        self._seconds[together] = 0.5 * (self._seconds.get(together, seconds) + seconds)

    def ticks(self, least: int) -> int:
        """Return how many ticks, at least ``least``, to run before the running time is measured again."""
        return max(least, round(_STRETCH_S / min(self._seconds.values(), default=_STRETCH_S)))


class Team:
    """Threads for one world.

    Args:
        program: in strips.
        threads: two at least.
        workers: of the pool that they are of.
        numbers: of a state.
    """

    def __init__(self, program: Program, threads: int, workers: int, numbers: int):
        self._program, self._threads, self._workers = program, threads, workers
        self._least = -(-NUMBERS_OF_A_CALL // numbers)
        self._pace = Pace()
        self._seats = program.seats(threads)

    def advance(self, addresses: Sequence[int], scratch: int, tick: int, count: int) -> None:
        """Advance a state by ``count`` ticks from tick number ``tick``, with several threads or one."""

        def run(together: bool, first: int, ticks: int) -> None:
            """Advance the state by some ticks from tick number ``first``, with all threads (``together``) or one."""
            if together:
                self._program.together(self._on_seats, addresses, tick + first, ticks)
            else:
                self._program(addresses, scratch, tick + first, ticks)

        self._run(run, count)

    def keep(self, addresses: Sequence[int], scratch: int, tick: int, rows: Buffers) -> None:
        """Advance one world by one tick per row, and write its state after each tick to that row."""

        def run(together: bool, first: int, ticks: int) -> None:
            """Advance by ``ticks`` from tick ``first`` and store each state, with all threads (``together``) or one."""
            some = rows[0][first : first + ticks], rows[1][first : first + ticks]
            if together:
                self._program.keeping_together(self._on_seats, addresses, tick + first, some)
            else:
                self._program.keeping(addresses, scratch, tick + first, some)

        self._run(run, len(rows[0]))

    def _run(self, run: Callable[[bool, int, int], None], count: int) -> None:
        """Run ``count`` ticks in portions by ``run(together, first, ticks)``, with several threads or one if faster."""
        first = 0
        while first < count:
            ticks = min(count - first, self._pace.ticks(self._least))
            if ticks < self._least:
                run(False, first, ticks)
            else:
                together = self._pace.together() and _BUSY.acquire(blocking=False)
                begin = perf_counter()
                try:
                    run(together, first, ticks)
                finally:
                    if together:
                        _BUSY.release()
                self._pace.took(together, (perf_counter() - begin) / ticks)
            first += ticks

    def _on_seats(self, function: Callable[[int], None]) -> None:
        """Call a function in each thread with the address of the thread's working memory (seat)."""
        seats, others = self._seats, list[Future[None]]()
        try:
            pool = worker_pool(self._workers)
            for seat in seats[1:]:
                others.append(pool.submit(function, seat.ctypes.data))
            function(seats[0].ctypes.data)
            for done in others:
                done.result()
        except BaseException:
            # Threads that wait for one that never came would wait for ever.
            self._program.give_up(seats)
            self._seats = self._program.seats(self._threads)
            wait(others)
            raise
