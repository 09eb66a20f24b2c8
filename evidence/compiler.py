"""Random programs by the package's own code generator, against a reference that says how far it may be."""

from __future__ import annotations

import contextlib
import hashlib
import json
import random
import sys
import tempfile
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import jax
import numpy as np

from evidence._bounds import AmbiguousError, Value, given
from evidence._programs import FEATURED, HANDED_OVER, MAKERS, Program
from evidence._reference import BITS_OF_NAN, evaluate
from qrsim.engine.layout import Packer
from qrsim.engine.llvm import Input, Mode, UnsupportedError, build
from qrsim.engine.llvm import Program as Compiled

DOC = "random programs by the package's own code generator, against a reference with bounds"
SEED = 20240229
MODES = (Mode(1, False), Mode(8, False), Mode(16, False), Mode(8, True), Mode(16, True))
PROGRAMS, PART = 20_000, 50
OUTCOMES = ("equal", "within", "ambiguous", "handed over")


def fly(program: Program, mode: Mode, ticks: int, tier: str = "quick") -> list[dict[str, Any]]:
    """Return the states of a program's worlds after some ticks by machine code.

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
        buffers, scratch = compiled.buffers(1), compiled.scratch()
        lanes = [packed[(begin + lane) % len(packed)] for lane in range(mode.worlds)]
        for which, mine in enumerate(buffers):
            for lane, values in enumerate(lanes):
                mine.reshape(-1, mode.worlds)[:, lane] = values[which]
        addresses = [part.ctypes.data for part in (*common, *buffers)]
        compiled(addresses, scratch.ctypes.data, 0, ticks)
        for lane in range(min(mode.worlds, len(packed) - begin)):
            flat = tuple(np.array(part.reshape(-1, mode.worlds)[:, lane]) for part in buffers)
            found.append(layouts[1].unpack(flat))
    return found


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
        # Programs of even numbers are those of earlier versions, because some of them found faults.
        featured = HANDED_OVER if choose.random() < 0.04 else choose.choice(FEATURED if number % 2 else MAKERS)
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
        better = fly(program, mode, ticks, "better")
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


def run(full: bool) -> dict[str, Any]:
    """Return how many programs ended how; the full form flies 20 000, in two processes, and can be resumed.

    Args:
        full: all of them, or so many that every kind of operation is among them.
    """
    total = PROGRAMS if full else 40
    found = _all_of(total) if full else _part((0, total))
    counts = dict.fromkeys(OUTCOMES, 0)
    wrong = []
    for number, what in sorted(found.items()):
        if what in counts:
            counts[what] += 1
        else:
            wrong.append(f"{number}: {what}")
    for line in wrong[:5]:
        print(line, file=sys.stderr)
    compiled = total - counts["handed over"]
    return {
        "programs": total,
        "compiled": compiled,
        "handed_over": counts["handed over"],
        "equal_to_the_bit": counts["equal"],
        "within": counts["within"],
        "ambiguous": counts["ambiguous"],
        "different": len(wrong),
    }


def _all_of(total: int) -> dict[int, str]:
    """Try all programs by two processes; what is done already lies in the folder of temporary files."""
    place = Path(tempfile.gettempdir()) / f"qrsim-evidence-compiler-{_state()}.json"
    found = {int(k): v for k, v in json.loads(place.read_text(encoding="utf-8")).items()} if place.exists() else {}
    parts = [(first, min(first + PART, total)) for first in range(0, total, PART)]
    parts = [part for part in parts if not found.keys() >= set(range(*part))]
    # Anew now and then, because compiled programs stay in memory.
    with get_context("spawn").Pool(2, maxtasksperchild=10) as pool:
        for done in _shown(pool.imap_unordered(_part, parts), len(parts)):
            found |= done
            place.write_text(json.dumps(found), encoding="utf-8")
    return found


def _state() -> str:
    """Return what a result depends on: the text of the code generator and of this study."""
    import qrsim

    digest = hashlib.sha256()
    root = Path(qrsim.__file__).parent
    for path in sorted([*root.glob("engine/llvm/*.py"), *root.glob("core/*.py"), *Path(__file__).parent.glob("*.py")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _shown(parts: Any, count: int) -> Any:
    """Give parts and show how many are done, where somebody looks."""
    from rich.progress import track

    return track(parts, "random programs", total=count)


def _part(numbers: tuple[int, int]) -> dict[int, str]:
    """Return what became of some programs."""
    found = {}
    for number in range(*numbers):
        try:
            found[number] = tried(number)[0]
        except Exception as error:
            found[number] = f"{type(error).__name__}: {error}"
    return found
