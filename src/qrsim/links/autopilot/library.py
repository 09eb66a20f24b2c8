"""The library of lockstep.c, compiled where it is first needed and kept in the user's cache folder."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from platformdirs import user_cache_path

from qrsim.errors import RunError, UsageError

SOURCE = Path(__file__).with_name("lockstep.c")
OPTIONS = ("-O2", "-shared", "-fPIC")
LIBRARIES = ("-ldl", "-lpthread")
LONGEST_S = 60.0


def compiled(folder: Path | None = None) -> Path:
    """Compile the C library that steps Betaflight in lock-step, unless it is cached in ``folder``; return its path.

    Args:
        folder: where it is kept; None: the cache folder of this user.

    Raises:
        UsageError: this is no Linux, or there is no gcc.
        RunError: gcc fails, or the folder cannot be written.
    """
    if sys.platform != "linux":
        raise UsageError("an autopilot's firmware is stepped on Linux only: its calls of the C library are taken over")
    text = SOURCE.read_bytes()
    name = f"lockstep-{hashlib.sha256(text).hexdigest()[:16]}-{os.uname().machine}.so"
    folder = user_cache_path("qrsim") / "autopilot" if folder is None else folder
    library = folder / name
    if library.is_file() and library.stat().st_uid == os.geteuid():
        return library
    compiler = shutil.which("gcc")
    if compiler is None:
        raise UsageError("an autopilot's firmware is stepped by a small C library, and gcc is not there: install gcc")
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Another process may compile it too: each writes a file of its own, and the last one stays.
        with tempfile.TemporaryDirectory(dir=folder) as beside:
            made = Path(beside) / name
            words = [compiler, *OPTIONS, "-o", str(made), str(SOURCE), *LIBRARIES]
            done = subprocess.run(words, capture_output=True, text=True, timeout=LONGEST_S, check=False)
            if done.returncode:
                said = (done.stderr.strip().splitlines() or ["no message"])[0]
                raise RunError(f"gcc cannot compile {SOURCE.name}: {said}")
            made.replace(library)
    except subprocess.TimeoutExpired:
        raise RunError(f"gcc has not compiled {SOURCE.name} within {LONGEST_S:g} s") from None
    except OSError as error:
        raise RunError(f"{folder}: {error.strerror or error}; XDG_CACHE_HOME names another place") from None
    return library
