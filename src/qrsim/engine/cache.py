"""Machine code in the user's cache, so that the next process neither traces nor compiles.

A file is a digest, a header in JSON and the object code. Its name and its header say all that the code depends on:
what was cut short or altered, or is of another program, version or machine, is made anew. A digest is no signature,
and what is in the folder is run: so only a folder is used that belongs to this user alone, see engine/folders.py.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import stat
from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.core.structure import from_plain, kinds, name_of, to_plain
from qrsim.engine.folders import private, temporary, tidy
from qrsim.engine.layout import Packer, struct
from qrsim.engine.llvm.compiler import machine_name
from qrsim.engine.llvm.program import Binary
from qrsim.engine.llvm.start import Start

# To be counted up where the form of a file changes.
MAGIC = b"qrsim program 1\n"
_DIGEST_BYTES = 32
_LENGTH_BYTES = 4
# What claims to be larger is none of ours, and is not read into memory.
_LARGEST_FILE = 2**28
_LARGEST_SCRATCH = 2**40
_FOREIGN = "not of this package: "


def folder() -> Path | None:
    """Return where code is kept, None where QRSIM_COMPILATION_CACHE is off."""
    if os.environ.get("QRSIM_COMPILATION_CACHE") == "off":
        return None
    from platformdirs import user_cache_path

    return user_cache_path("qrsim") / "native"


@lru_cache(maxsize=1)
def _sources() -> str:
    """Return a digest of this package as it is installed: any edit of it makes other programs."""
    # Sizes and times of files, because to read all of them would make every start slower.
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        found = path.stat()
        digest.update(f"{path.relative_to(root)} {found.st_size} {found.st_mtime_ns}\n".encode())
    return digest.hexdigest()


@lru_cache(maxsize=1)
def _origin() -> dict[str, str]:
    """List the versions, processor and sources that all programs of this process depend on."""
    versions = {name: version(name) for name in ("jax", "numpy", "llvmlite")}
    return {"sources": _sources(), "machine": machine_name(), **versions}


def identity(layout: Packer) -> str:
    """Return a layout as text: structure with the names of its types, settings and shapes, without values."""
    names = sorted({name_of(kind) for kind in kinds(layout.structure)})
    # What somebody else's code does can change without a change of its name.
    foreign = [name for name in names if not name.startswith(("qrsim.", "builtins:"))]
    text = repr((layout.structure, layout.shapes, layout.dtypes, names))
    return f"{_FOREIGN}{foreign} {text}" if foreign else text


def kept(what: tuple[Any, ...], make: Callable[[], Any]) -> Any:
    """Take the result of ``make`` from the cache, or make and keep it.

    Args:
        what: all that it depends on beside this package and the machine; its repr is the key.
        make: called where the cache has nothing; returns a Binary, a Start or a whole number.
    """
    place = folder()
    if place is None or any(isinstance(part, str) and part.startswith(_FOREIGN) for part in what):
        return make()
    if not private(place):
        return make()
    _tidied(place, os.getpid())
    # The origin is part of the name too, so that two versions of the package keep their programs side by side.
    key = hashlib.sha256(repr((what, sorted(_origin().items()))).encode()).hexdigest()
    path = place / f"{key}.bin"
    found = _read(path, key)
    if found is None:
        found = make()
        _write(path, key, found)
    return found


@lru_cache(maxsize=4)
def _tidied(place: Path, process: int) -> None:
    tidy(place)


def _read(path: Path, key: str) -> Binary | Start | int | None:
    try:
        data = _bytes(path)
        if data is None:
            return None
        begin = len(MAGIC) + _DIGEST_BYTES
        content = data[begin:]
        # Before anything of it is parsed.
        if data[: len(MAGIC)] != MAGIC or hashlib.sha256(content).digest() != data[len(MAGIC) : begin]:
            return None
        end = _LENGTH_BYTES + int.from_bytes(content[:_LENGTH_BYTES], "little")
        return _parsed(json.loads(content[_LENGTH_BYTES:end]), content[end:], key)
    # Whatever is wrong with it, the program is made anew.
    except (OSError, ValueError, TypeError, LookupError, RecursionError, AttributeError):
        return None


def _bytes(path: Path) -> bytes | None:
    """Read a file of this user's own; None where it is anything else."""
    # A link could lead to a file that somebody else can change, and a pipe would be waited for.
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    with open(os.open(path, flags), "rb") as file:
        found = os.fstat(file.fileno())
        own = not hasattr(os, "geteuid") or found.st_uid == os.geteuid()
        if not stat.S_ISREG(found.st_mode) or not own or found.st_size > _LARGEST_FILE:
            return None
        data = file.read(_LARGEST_FILE)
    with contextlib.suppress(OSError):
        # The time of its last use: what was not used for longest is deleted first.
        os.utime(path)
    return data


def _parsed(header: dict[str, Any], code: bytes, key: str) -> Binary | Start | int | None:
    expected = {"key": key, "origin": _origin(), "code_bytes": len(code)}
    if any(header[name] != value for name, value in expected.items()):
        return None
    if header["number"] is not None:
        return header["number"] if type(header["number"]) is int and not code else None
    scratch = header["scratch_bytes"]
    if type(scratch) is not int or not 0 <= scratch < _LARGEST_SCRATCH or not code:
        return None
    binary, state = Binary(code, scratch), header["state"]
    if state is None:
        return binary
    leaves = iter([struct(tuple(shape), np.dtype(dtype)) for shape, dtype in state["leaves"]])
    start = Start(binary, from_plain(state["structure"], leaves))
    # A structure that was read back as another one would put numbers into the wrong fields.
    return start if identity(start.layout) == state["identity"] else None


def _write(path: Path, key: str, made: Binary | Start | int) -> None:
    # A state with something in it that is no plain data is made anew in every process.
    try:
        state = _state(made) if isinstance(made, Start) else None
    except TypeError:
        return
    number = made if isinstance(made, int) else None
    # A number has no code.
    binary = Binary(b"", 0) if isinstance(made, int) else made.binary if isinstance(made, Start) else made
    header = json.dumps(
        {
            "key": key,
            "origin": _origin(),
            "scratch_bytes": binary.scratch_bytes,
            "code_bytes": len(binary.code),
            "state": state,
            "number": number,
        }
    ).encode()
    content = len(header).to_bytes(_LENGTH_BYTES, "little") + header + binary.code
    part = temporary(path)
    # A cache that cannot be written costs time, nothing else.
    with contextlib.suppress(OSError):
        try:
            with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(MAGIC + hashlib.sha256(content).digest() + content)
            # In one step, so that another process sees the whole file or none.
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)


def _state(start: Start) -> dict[str, Any]:
    """Return how the state of a start looks, in plain data."""
    layout = start.layout
    leaves = [[list(shape), str(dtype)] for shape, dtype in zip(layout.shapes, layout.dtypes, strict=True)]
    return {"structure": to_plain(layout.structure), "leaves": leaves, "identity": identity(layout)}
