"""Machine code in the user's cache, so that the next process neither traces nor compiles.

A file is named by all that its content depends on, holds its own digest, and is read only if that is right: what was
cut short or altered is made anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import tempfile
from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from qrsim.core.pack import Packer
from qrsim.native.compiler import machine_name

_DIGEST_BYTES = 32


def folder() -> Path | None:
    """Return where code is kept, None where QRSIM_COMPILATION_CACHE is off."""
    if os.environ.get("QRSIM_COMPILATION_CACHE") == "off":
        return None
    from platformdirs import user_cache_path

    return user_cache_path("qrsim") / "native"


@lru_cache(maxsize=1)
def _sources() -> str:
    """Return a digest of this package as it is installed: any edit of it makes other programs."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        found = path.stat()
        digest.update(f"{path.relative_to(root)} {found.st_size} {found.st_mtime_ns}\n".encode())
    digest.update(" ".join(version(name) for name in ("jax", "numpy", "llvmlite")).encode())
    return digest.hexdigest()


def identity(layout: Packer) -> str:
    """Return a layout as text: structure, settings and shapes, without values."""
    return repr((layout.structure, layout.shapes, layout.dtypes))


def kept(what: tuple[Any, ...], make: Callable[[], Any]) -> Any:
    """Return what ``make`` makes, from the cache if it was made before.

    Args:
        what: all that it depends on beside this package and the machine; its repr is the key.
        make: called where the cache has nothing; what it returns can be pickled.
    """
    place = folder()
    if place is None:
        return make()
    key = hashlib.sha256(repr((what, _sources(), machine_name())).encode()).hexdigest()
    path = place / f"{key}.bin"
    found = _read(path)
    if found is None:
        found = make()
        _write(path, found)
    return found


def _read(path: Path) -> Any:
    try:
        data = path.read_bytes()
    except OSError:
        return None
    digest, content = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        return None
    return pickle.loads(content)


def _write(path: Path, value: Any) -> None:
    # A cache that cannot be written costs time, nothing else.
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        content = pickle.dumps(value)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(hashlib.sha256(content).digest() + content)
        os.replace(file.name, path)
