"""Versions that results depend on: compared between client and workers, and between a store and its continuation."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib import metadata, resources
from importlib.resources.abc import Traversable

PACKAGES = ("qrsim", "jax", "jaxlib", "llvmlite", "numpy", "scipy")
NETWORK = ("dask", "distributed")
# Of this package, what no number comes from.
WITHOUT = ("/view", "/logs", "/studies/flight_logs", "/protocol")


@cache
def versions() -> dict[str, str]:
    """Return name -> version of all libraries that affect results, with a digest of this package's source."""
    found = {name: metadata.version(name) for name in PACKAGES}
    return {**found, "python": ".".join(platform.python_version_tuple()[:2]), "qrsim source": _source()}


def network_versions() -> dict[str, str]:
    """Return ``versions`` and the versions of the libraries that carry tasks and results to workers."""
    return {**versions(), **{name: metadata.version(name) for name in NETWORK}}


def _source() -> str:
    """Return a digest of those Python files of the package that affect results."""
    total = hashlib.sha256()

    def add(folder: Traversable, path: str) -> None:
        """Add the Python files of a folder to the digest; ``path`` is its name in the package."""
        for item in sorted(folder.iterdir(), key=lambda item: item.name):
            inner = f"{path}/{item.name}"
            other = inner in WITHOUT or (path == "/apps" and item.name != "sweep")
            if item.is_dir() and item.name != "__pycache__" and not other:
                add(item, inner)
            elif item.name.endswith(".py"):
                total.update(f"{inner}\0".encode() + item.read_bytes())

    add(resources.files("qrsim"), "")
    return total.hexdigest()[:16]


def differences(mine: dict[str, str], theirs: dict[str, str]) -> list[str]:
    """Return the entries that differ between two dicts of versions, each as "name: mine, theirs"."""
    return [
        f"{name}: {mine.get(name, 'none')} here, {theirs.get(name, 'none')} there"
        for name in {**mine, **theirs}
        if mine.get(name) != theirs.get(name)
    ]
