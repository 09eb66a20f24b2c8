"""Libraries that only some formats need."""

from __future__ import annotations

import importlib
from typing import Any

from qrsim.errors import RunError


def load_extra(module: str, package: str, purpose: str) -> Any:
    """Import a module of the optional extra 'identify'.

    Raises:
        RunError: the package is not installed; says how to.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError:
        raise RunError(f"{purpose} needs {package}: python -m pip install 'qrsim[identify]'") from None
