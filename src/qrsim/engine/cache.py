"""Machine code in the user's cache, so that the next process neither traces nor compiles.

Two keys lead to it. The first is the structure of a program's inputs with a digest of the sources that are traced: it
finds the second one without tracing. The second is a digest of the program itself, as it was traced, with the sources
of the code generator: it finds the machine code. So an edit of a comment costs a trace, and worlds with a user's own
code, which only tracing can tell from each other, are compiled once.

A file is a digest, a header in JSON and the object code. Its name and its header say all that the code depends on:
what was cut short or altered, or is of another program, version or machine, is made again. A digest is no signature,
and what is in the folder is run: so only a folder is used that belongs to this user alone, see engine/folders.py.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import stat
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.core.structure import from_plain, kinds, name_of, to_plain
from qrsim.engine.folders import cache_folder, private, temporary, tidy
from qrsim.engine.layout import Packer, struct
from qrsim.engine.llvm.compiler import machine_name
from qrsim.engine.llvm.program import Binary
from qrsim.files import Content

# To be counted up where the form of a file changes.
MAGIC = b"qrsim program 2\n"
SUFFIX = ".bin"
_DIGEST_BYTES = 32
_LENGTH_BYTES = 4
# What claims to be larger is none of ours, and is not read into memory.
LARGEST_FILE = 2**28
_LARGEST_SCRATCH = 2**40
_FOREIGN = "not of this package: "
# Sources that make a program: the code generator, and all that is traced.
GENERATOR = ("core", "engine/layout.py", "engine/llvm")
TRACED = (*GENERATOR, "control", "interface", "models", "simulation", "tasks", "world")
_HEADER = {"key", "origin", "bytes", "scratch_bytes", "local_bytes", "text_bytes", "program", "state", "number"}


@dataclass(frozen=True)
class Known:
    """What the first key leads to.

    Attributes:
        program: the second key.
        state: layout of the state that a start makes; None of any other program.
    """

    program: str
    state: Packer | None = None


Kept = Binary | Known | int


def folder() -> Path | None:
    """Return the folder of cached programs; None if QRSIM_COMPILATION_CACHE switches the cache off."""
    if os.environ.get("QRSIM_COMPILATION_CACHE") == "off":
        return None
    return cache_folder() / "native"


@lru_cache(maxsize=4)
def _sources(rooms: tuple[str, ...]) -> str:
    """Return a digest of all Python source files in ``rooms``: folders or files of this package."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for room in rooms:
        for path in sorted((root / room).rglob("*.py")) if (root / room).is_dir() else [root / room]:
            content = path.read_bytes()
            digest.update(f"{path.relative_to(root).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()


@lru_cache(maxsize=4)
def _origin(rooms: tuple[str, ...]) -> dict[str, str]:
    """Return the dependencies of cached programs by name: versions, processor, and digest of sources in ``rooms``."""
    versions = {name: version(name) for name in ("jax", "numpy", "llvmlite")}
    return {"sources": _sources(rooms), "machine": machine_name(), **versions}


def identity(layout: Packer) -> str:
    """Return a layout as text that identifies it: tree structure, type names, settings and shapes, no values."""
    names = sorted({name_of(kind) for kind in kinds(layout.structure)})
    # What somebody else's code does can change without a change of its name.
    foreign = [name for name in names if not name.startswith(("qrsim.", "builtins:"))]
    text = repr((layout.structure, layout.shapes, layout.dtypes, names))
    return f"{_FOREIGN}{foreign} {text}" if foreign else text


def kept(what: tuple[object, ...], make: Callable[[], Any]) -> Any:
    """Return the cached result under the key ``what``, or call ``make`` and cache its result."""
    found = look_up(what)
    if found is None:
        found = make()
        keep(what, found)
    return found


def look_up(what: tuple[object, ...], rooms: tuple[str, ...] = TRACED) -> Any:
    """Return the value cached under the key ``what`` for the same sources in ``rooms``; None if there is none.

    Args:
        what: all that it depends on apart from this package and the machine; its repr is the key.
        rooms: of this package, on which it depends.
    """
    place = _place(what, rooms)
    return None if place is None else _read_entry(*place)


def keep(what: tuple[object, ...], value: Kept, rooms: tuple[str, ...] = TRACED) -> None:
    """Cache a value under the key ``what``, for the sources in ``rooms``; errors of the file system are ignored."""
    place = _place(what, rooms)
    if place is not None:
        _write_entry(*place, value)


def _place(what: tuple[object, ...], rooms: tuple[str, ...]) -> tuple[Path, str, tuple[str, ...]] | None:
    """Return (file, key text, ``rooms``) of the cache entry for the key ``what``; None if it cannot be cached."""
    place = folder()
    if place is None or any(isinstance(part, str) and part.startswith(_FOREIGN) for part in what):
        return None
    if not private(place):
        return None
    _tidied(place, os.getpid())
    # The origin is part of the name too, so that two versions of the package keep their programs side by side.
    key = hashlib.sha256(repr((what, sorted(_origin(rooms).items()))).encode()).hexdigest()
    return place / f"{key}{SUFFIX}", key, rooms


@lru_cache(maxsize=4)
def _tidied(place: Path, process: int) -> None:
    """Remove old files of a cache folder, once per process id."""
    tidy(place)


def _read_entry(path: Path, key: str, rooms: tuple[str, ...]) -> Kept | None:
    """Read a cache file; return None if it is missing, damaged or of another key, version or sources (``rooms``)."""
    try:
        data = file_bytes(path)
        if data is None:
            return None
        header, code = opened(data)
        with contextlib.suppress(OSError):
            # The time of its last use: what was not used for longest is deleted first.
            os.utime(path)
        return _parsed_entry(header, code, key, _origin(rooms))
    # Whatever is wrong with it, the program is made again.
    except (OSError, ValueError, TypeError, LookupError, RecursionError, AttributeError):
        return None


def file_bytes(path: Path) -> bytes | None:
    """Return the content of a file; None if it is no regular file, owned by another user or too large."""
    # A pipe would wait for somebody to write into it.
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    with open(os.open(path, flags), "rb") as file:
        found = os.fstat(file.fileno())
        own = not hasattr(os, "geteuid") or found.st_uid == os.geteuid()
        if not stat.S_ISREG(found.st_mode) or not own or found.st_size > LARGEST_FILE:
            return None
        return file.read(LARGEST_FILE)


def opened(data: bytes) -> tuple[Content, bytes]:
    """Split the bytes of a cache file into its header and machine code.

    Raises:
        ValueError: it is none of ours, or was altered.
    """
    begin = len(MAGIC) + _DIGEST_BYTES
    content = data[begin:]
    # Before anything of it is parsed.
    if data[: len(MAGIC)] != MAGIC or hashlib.sha256(content).digest() != data[len(MAGIC) : begin]:
        raise ValueError("not a program, or not whole")
    end = _LENGTH_BYTES + int.from_bytes(content[:_LENGTH_BYTES], "little")
    header = json.loads(content[_LENGTH_BYTES:end])
    if not isinstance(header, dict) or header.keys() != _HEADER:
        raise ValueError("not a header")
    return header, content[end:]


def _parsed_entry(header: Content, code: bytes, key: str, origin: dict[str, str]) -> Kept | None:
    """Return the value of a cache file; None if its header has another key or origin."""
    expected = {"key": key, "origin": origin, "bytes": len(code)}
    if any(header[name] != value for name, value in expected.items()):
        return None
    if header["number"] is not None:
        return header["number"] if type(header["number"]) is int and not code else None
    if header["program"] is not None:
        if type(header["program"]) is not str or code:
            return None
        return Known(header["program"], _parsed_state(header["state"]))
    scratch, text, local = header["scratch_bytes"], header["text_bytes"], header["local_bytes"]
    if any(type(size) is not int or not 0 <= size < _LARGEST_SCRATCH for size in (scratch, local)):
        return None
    if type(text) is not int or not 0 <= text < len(code):
        return None
    return Binary(code[: len(code) - text], scratch, code[len(code) - text :], local)


def _parsed_state(state: Content | None) -> Packer | None:
    """Return the buffer layout of a state from a cache file's header; raise an error if it does not match."""
    if state is None:
        return None
    leaves = iter([struct(tuple(shape), np.dtype(dtype)) for shape, dtype in state["leaves"]])
    found = Packer(from_plain(state["structure"], leaves))
    # A structure that was read back as another one would put numbers into the wrong fields.
    if identity(found) != state["identity"]:
        raise ValueError("another structure")
    return found


def _write_entry(path: Path, key: str, rooms: tuple[str, ...], value: Kept) -> None:
    """Write a value to a cache file, for sources in ``rooms``; layouts that are not plain data are not stored."""
    # A state with something in it that is no plain data is traced in every process.
    try:
        state = _plain_state(value.state) if isinstance(value, Known) and value.state is not None else None
    except TypeError:
        return
    binary = value if isinstance(value, Binary) else Binary(b"", 0)
    body = binary.code + binary.text
    header = json.dumps(
        {
            "key": key,
            "origin": _origin(rooms),
            "bytes": len(body),
            "scratch_bytes": binary.scratch_bytes,
            "text_bytes": len(binary.text),
            "local_bytes": binary.local_bytes,
            "program": value.program if isinstance(value, Known) else None,
            "state": state,
            "number": value if isinstance(value, int) else None,
        }
    ).encode()
    content = len(header).to_bytes(_LENGTH_BYTES, "little") + header + body
    write_file(path, MAGIC + hashlib.sha256(content).digest() + content)


def write_file(path: Path, data: bytes) -> None:
    """Write a file atomically: other processes see the whole file or none; errors are ignored."""
    part = temporary(path)
    with contextlib.suppress(OSError):
        try:
            with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(data)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)


def _plain_state(layout: Packer) -> dict[str, object]:
    """Return a state's layout as plain data for a cache file's header."""
    leaves = [[list(shape), str(dtype)] for shape, dtype in zip(layout.shapes, layout.dtypes, strict=True)]
    return {"structure": to_plain(layout.structure), "leaves": leaves, "identity": identity(layout)}
