"""Random programs compiled by the package's own code generator and compared with the reference."""

from __future__ import annotations

import contextlib
import random
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
from tests.engine.reference.bounds import AmbiguousError, Value, given
from tests.engine.reference.elements import BITS_OF_NAN
from tests.engine.reference.evaluation import evaluate
from tests.engine.reference.programs import FEATURED, HALVES, HANDED_OVER, MAKERS, Program

from qrsim.engine.layout import Packer
from qrsim.engine.llvm import Input, Mode, UnsupportedError, build
from qrsim.engine.llvm import Program as Compiled

SEED = 20240229
MODES = (Mode(1, False), Mode(8, False), Mode(16, False), Mode(8, True), Mode(16, True))
OUTCOMES = ("equal", "within", "ambiguous", "handed over")


def fly(program: Program, mode: Mode, ticks: int, tier: str = "quick", threads: int = 1) -> list[dict[str, Any]]:
    """Return the states of a program's worlds after some ticks by machine code, each world on some threads.

    Raises:
        UnsupportedError: it does not take the program.
    """
    layouts = Packer(program.shared), Packer(program.worlds[0])
    inputs = [Input(layouts[0], own=False), Input(layouts[1], own=True)]
    compiled = Compiled(build(program.closed, inputs, mode, tier), inputs, mode)
    common = compiled.buffers(0)
    for mine, values in zip(common, layouts[0].pack(program.shared), strict=True):
        mine[...] = values
    found = []
    packed = [layouts[1].pack(world) for world in program.worlds]
    for begin in range(0, len(packed), mode.worlds):
        buffers, several = compiled.buffers(1), threads > 1 and compiled.local_bytes > 0
        seats = compiled.seats(threads) if several else [compiled.scratch()]
        lanes = [packed[(begin + lane) % len(packed)] for lane in range(mode.worlds)]
        for which, mine in enumerate(buffers):
            for lane, values in enumerate(lanes):
                mine.reshape(-1, mode.worlds)[:, lane] = values[which]
        addresses = [part.ctypes.data for part in (*common, *buffers)]
        if several:
            compiled.together(partial(on_seats, seats), addresses, 0, ticks)
        else:
            compiled(addresses, seats[0].ctypes.data, 0, ticks)
        for lane in range(min(mode.worlds, len(packed) - begin)):
            flat = tuple(np.array(part.reshape(-1, mode.worlds)[:, lane]) for part in buffers)
            found.append(layouts[1].unpack(flat))
    return found


def on_seats(seats: list[Any], function: Callable[[int], None]) -> None:
    """Call a function with the address of each seat, each in a thread."""
    others = [threading.Thread(target=function, args=(seat.ctypes.data,)) for seat in seats[1:]]
    for thread in others:
        thread.start()
    function(seats[0].ctypes.data)
    for thread in others:
        thread.join()


def expected(program: Program, ticks: int) -> list[list[Value]]:
    """Return what the worlds' states should be after some ticks, leaf by leaf.

    Raises:
        AmbiguousError: roundings decide it.
    """
    shared, found = [given(leaf) for leaf in jax.tree.leaves(program.shared)], []
    for world in program.worlds:
        state = [given(leaf) for leaf in jax.tree.leaves(world)]
        for tick in range(ticks):
            state = evaluate(program.closed, [*shared, *state, given(np.int32(tick))])
        found.append(state)
    return found


def judged(mine: list[Any], reference: list[list[Value]], factor: float = 2.0) -> str:
    """Return "equal" to the bit, "within" the bounds, or what is wrong.

    Args:
        mine: trees of worlds.
        reference: of the same worlds.
        factor: how many of the bounds are allowed, because products may be rounded or not where they are summed up.
    """
    equal = True
    for world, (tree, leaves) in enumerate(zip(mine, reference, strict=True)):
        for (path, leaf), value in zip(jax.tree_util.tree_flatten_with_path(tree)[0], leaves, strict=True):
            numbers, wanted = np.asarray(leaf), value.rounded
            if numbers.dtype.kind == "f":
                same = (numbers == wanted) | (np.isnan(numbers) & np.isnan(wanted))
            else:
                same = numbers == wanted
            equal = equal and bool(same.all())
            if not _inside(numbers, value, factor).all():
                at = np.argwhere(~_inside(numbers, value, factor))[0]
                place = tuple(at)
                return (
                    f"world {world} {jax.tree_util.keystr(path)}{list(map(int, at))}: {numbers[place]!r}, not "
                    f"{value.exact[place]!r} +- {value.error[place]:.3g}"
                )
    return "equal" if equal else "within"


def _inside(numbers: Any, value: Value, factor: float) -> Any:
    if numbers.dtype.kind != "f":
        return (numbers == value.exact) | ~np.isfinite(value.error)
    with np.errstate(invalid="ignore", over="ignore"):
        near = np.abs(numbers.astype(value.exact.dtype) - value.exact) <= factor * value.error
    same = (numbers == value.exact) | (np.isnan(numbers) & np.isnan(value.exact))
    return near | same | ~np.isfinite(value.error)


def tried(number: int, featured: Any = None, longest: int = 11) -> tuple[str, Program]:
    """Return what became of one random program: one of OUTCOMES, or what is wrong; and the program.

    Args:
        number: of the program.
        featured: what it has in any case, one of FEATURED; None: at random, now and then something that is XLA's.
        longest: the most makers that it has.
    """
    choose = random.Random(SEED * 1_000_003 + number)
    if featured is None:
        # Programs are those of earlier versions but for every fourth, because some of them found faults.
        known = MAKERS if number % 2 == 0 else FEATURED if number % 4 == 3 else (*FEATURED, *[HALVES] * 8)
        featured = HANDED_OVER if choose.random() < 0.04 else choose.choice(known)
    double = choose.random() < 0.1
    with jax.enable_x64(double), np.errstate(all="ignore"):
        program = Program(choose, featured, choose.randrange(2, longest + 1), double)
        mode, ticks = choose.choice(MODES), choose.choice((1, 2, 3))
        if double and mode.lanes == 16:
            mode = Mode(8, mode.side_by_side)
        try:
            mine = fly(program, mode, ticks)
        except UnsupportedError as error:
            return ("handed over" if "code generator itself" not in str(error) else str(error)), program
        # One world in strips, on one thread or several, has the same bits too.
        cut = mode if mode.side_by_side else replace(mode, strip=max(4, mode.lanes))
        better = fly(program, cut, ticks, "better", 1 if mode.side_by_side else choose.choice((1, 2, 3)))
        # The sign of NaN is none of a number, and compilers choose it.
        if any(not _alike(a, b) for a, b in zip(*map(jax.tree.leaves, (mine, better)), strict=True)):
            return ("ambiguous" if _looks_into_nan(program, ticks) else "quick and better code differ"), program
        try:
            return judged(mine, expected(program, ticks)), program
        except AmbiguousError:
            return "ambiguous", program


def _looks_into_nan(program: Program, ticks: int) -> bool:
    """Return whether a program takes the bits of a NaN, whose sign is the compiler's."""
    BITS_OF_NAN.clear()
    with contextlib.suppress(AmbiguousError):
        expected(program, ticks)
    return bool(BITS_OF_NAN)


def _alike(a: Any, b: Any) -> bool:
    """Return whether arrays have the same bits, but for those of NaN."""
    if a.dtype.kind != "f":
        return bool(a.tobytes() == b.tobytes())
    same = a.view(f"i{a.dtype.itemsize}") == b.view(f"i{b.dtype.itemsize}")
    return bool((same | (np.isnan(a) & np.isnan(b))).all())
