"""Saved states with something wrong in them: for the fuzz study, and in a small form for the tests.

Half of them are bytes changed at random; a ZIP file's check sums find nearly all of those. The others are archives put
together anew with right check sums, in which a type, a shape, a value, a name or a size is wrong.
"""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from qrsim.errors import UsageError
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.simulation.snapshot import LARGEST_TICK

Content = dict[str, Any]
DTYPES = (
    "i1",
    "?",
    "f2",
    "f4",
    "f8",
    "i2",
    "i4",
    "i8",
    "u1",
    "u4",
    "u8",
    "c8",
    ">f4",
    ">i4",
    "S4",
    "U1",
    "V4",
    "M8[s]",
)
NUMBERS = (-1, 2**31 - 1, 2**31, 2**40, 2**63 - 1, 2**64 - 1, 0.5, float("nan"), True, "1", [1], [[1, 2]], b"x")
FLOATS = (np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-45, 1e9, -1.0, 0.0)
INTEGERS = (-1, -(2**31), 2**31 - 1, 2, 7, 99, 2**16, 255)


def saved_state(scenario: str = "patrol_plain", ticks: int = 60) -> bytes:
    """Return a state to be changed."""
    simulation = simulation_of(scenario)
    simulation.reset()
    simulation.step(ticks=ticks)
    return simulation.save()


def simulation_of(scenario: str) -> Simulation:
    """Return a simulation that has not started."""
    loaded = load_scenario(scenario)
    return Simulation(loaded.world(), seed=3, name=loaded.name)


def attempt(simulation: Simulation, data: bytes) -> str:
    """Load a state and, where it is taken, fly on; return "refused" or "taken". Anything else is a fault."""
    try:
        simulation.load(data)
    except UsageError as error:
        if not str(error).startswith("saved state") or "\n" in str(error):
            raise AssertionError(f"not one clear line: {error}") from None
        return "refused"
    left = LARGEST_TICK - simulation.tick
    if left:
        simulation.step(ticks=min(30, left))
    assert len(simulation.reasons) == simulation.size
    repr(simulation.reading)
    simulation.save()
    return "taken"


def mutants(saved: bytes, seed: int, count: int) -> Iterator[tuple[str, bytes]]:
    """Yield ``count`` changed states, each with what was done to it."""
    random = np.random.default_rng(seed)
    with np.load(io.BytesIO(saved)) as archive:
        content = {name: archive[name] for name in archive.files}
    kinds = list(_CHANGES)
    for i in range(count):
        if i % 2:
            yield _bytes(saved, random)
            continue
        kind = kinds[int(random.integers(len(kinds)))]
        yield kind, _CHANGES[kind](dict(content), random)


def _bytes(saved: bytes, random: Any) -> tuple[str, bytes]:
    kind = ("flip", "cut", "insert", "repeat", "zero", "swap")[int(random.integers(6))]
    data = bytearray(saved)
    at, length = int(random.integers(len(data))), int(random.integers(1, 64))
    if kind == "flip":
        # Half of them in the directory and the headers, which are a small part of the file.
        places = random.integers(0, len(data), length // 8 + 1)
        if random.integers(2):
            places = len(data) - 1 - places % 700
        for place in places:
            data[place] ^= 1 << int(random.integers(8))
    elif kind == "cut":
        del data[at : at + (length if random.integers(2) else len(data))]
    elif kind == "insert":
        data[at:at] = random.bytes(length)
    elif kind == "repeat":
        data[at:at] = data[: at or 1]
    elif kind == "zero":
        data[at : at + length] = bytes(len(data[at : at + length]))
    else:
        other = int(random.integers(len(data)))
        data[at : at + length], data[other : other + length] = data[other : other + length], data[at : at + length]
    return kind, bytes(data)


def _packed(content: Content) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **content)
    return buffer.getvalue()


def _choice(random: Any, among: Any) -> Any:
    return among[int(random.integers(len(among)))]


def _of_type(content: Content, random: Any) -> bytes:
    name = _choice(random, ("floats", "integers"))
    dtype = np.dtype(_choice(random, DTYPES))
    # The right number of elements in another type, or the right number of bytes.
    if random.integers(2) and content[name].nbytes % dtype.itemsize == 0:
        content[name] = content[name].view(dtype)
    else:
        content[name] = np.zeros(content[name].shape, dtype)
    return _packed(content)


def _of_shape(content: Content, random: Any) -> bytes:
    name = _choice(random, ("floats", "integers"))
    array = content[name]
    content[name] = _choice(
        random, (array[:-1], array[:0], np.append(array, array[:1]), array[None], array[:, None], array[:1], array[0])
    )
    return _packed(content)


def _of_value(content: Content, random: Any) -> bytes:
    array = content["floats"].copy()
    which = random.integers(0, len(array), int(_choice(random, (1, 1, 3, 100, 10_000))))
    if random.integers(2):
        array[which] = _choice(random, FLOATS)
    else:
        array[which] = random.integers(0, 2**32, len(which), np.uint32).view(np.float32)
    return _packed(content | {"floats": array})


def _of_integer(content: Content, random: Any) -> bytes:
    array = content["integers"].copy()
    which = random.integers(0, len(array), int(_choice(random, (1, 1, 3, 1000))))
    array[which] = _choice(random, INTEGERS) if random.integers(2) else random.integers(-(2**31), 2**31, len(which))
    return _packed(content | {"integers": array})


def _of_number(content: Content, random: Any) -> bytes:
    name = _choice(random, ("tick", "seed", "number", "format"))
    return _packed(content | {name: _choice(random, (*NUMBERS, int(random.integers(2**31))))})


def _of_text(content: Content, random: Any) -> bytes:
    values = ("", "hover", "x" * 5000, "\n\x00", 5, b"patrol_plain", ["a", "b"], "\U0010ffff")
    return _packed(content | {_choice(random, ("name", "world")): _choice(random, values)})


def _of_names(content: Content, random: Any) -> bytes:
    name = _choice(random, list(content))
    value = content.pop(name)
    if random.integers(2):
        content[_choice(random, ("../x", "Floats", "floats2", "a" * 300))] = value
    return _packed(content)


def _twice(content: Content, random: Any) -> bytes:
    """The same name again, or many more entries."""
    buffer = io.BytesIO(_packed(content))
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "a") as archive:
        warnings.simplefilter("ignore", UserWarning)
        for i in range(int(_choice(random, (1, 1, 20_000)))):
            archive.writestr(zipfile.ZipInfo(f"{_choice(random, ['floats', 'tick'])}.npy" if i == 0 else f"{i}"), b"")
    return buffer.getvalue()


def _compressed(content: Content, random: Any) -> bytes:
    """Zeros that take a thousandth of their size, more of them than there is memory for."""
    method = _choice(random, (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, value in content.items():
            entry = io.BytesIO()
            np.save(entry, value)
            data = entry.getvalue()
            if name == "floats":
                data = _header("<f4", f"({2 ** int(_choice(random, (10, 24, 40)))},)") + bytes(2**20)
            archive.writestr(f"{name}.npy", data)
    return buffer.getvalue()


def _header(descr: str, shape: str, order: str = "False") -> bytes:
    text = f"{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}"
    text += " " * (-(len(text) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode("latin-1")


def _of_header(content: Content, random: Any) -> bytes:
    """Headers of arrays that say something else than there is."""
    name = _choice(random, list(content))
    size = content["floats"].size
    shapes = (f"({2**62},)", f"({size}, {2**60})", "(-1,)", "()", f"({size}L,)", f"({size},)", "(1e9,)", "(" * 900)
    descr = _choice(random, (*DTYPES, "O", "<f4", "x" * 50, "<f99999999", "|V0", "__import__('os')"))
    header = _header(descr, _choice(random, shapes), _choice(random, ("False", "True", "None")))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for own, value in content.items():
            entry = io.BytesIO()
            np.save(entry, value)
            data = entry.getvalue()
            archive.writestr(f"{own}.npy", header + data[128:] if own == name else data)
    return buffer.getvalue()


_CHANGES: dict[str, Callable[[Content, Any], bytes]] = {
    "type": _of_type,
    "shape": _of_shape,
    "value": _of_value,
    "integer": _of_integer,
    "number": _of_number,
    "text": _of_text,
    "names": _of_names,
    "twice": _twice,
    "compressed": _compressed,
    "header": _of_header,
}
