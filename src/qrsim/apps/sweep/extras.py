"""Libraries that only sweeps need."""

from __future__ import annotations

from importlib.util import find_spec

from qrsim.errors import RunError

LIBRARIES = ("distributed", "xarray", "zarr", "SALib")


def require(what: str) -> None:
    """Refuse to begin where a library is missing.

    Raises:
        RunError: it names them, and says how to install them.
    """
    missing = [name for name in LIBRARIES if find_spec(name) is None]
    if missing:
        raise RunError(f"{what} needs {', '.join(missing)}; install: pip install 'qrsim[sweep]'")
