"""Folders of compiled programs: only those are used that nobody else can write into, because what is in them is run."""

from __future__ import annotations

import contextlib
import os
import stat
import time
from functools import lru_cache
from pathlib import Path

from qrsim.errors import warn_user

# Of one folder; what was used longest ago goes first.
LARGEST_BYTES = 512 * 2**20
STALE_S = 3600.0
# Who owns files of users that a container does not know.
_NOBODY = 65534


def cache_folder() -> Path:
    """Return the folder of everything compiled: QRSIM_CACHE_DIR, or one in the user's cache folder."""
    named = os.environ.get("QRSIM_CACHE_DIR")
    if named:
        return Path(os.path.expanduser(named)).absolute()
    from platformdirs import user_cache_path

    return user_cache_path("qrsim")


def private(path: Path) -> bool:
    """Return whether a folder belongs to this user alone; creates it if missing, and restricts its permissions.

    Where it belongs to somebody else, or others can write into it, one warning says so.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            path.mkdir(mode=0o700)
        if not hasattr(os, "geteuid"):
            return path.is_dir()
        found = path.lstat()
        why = _open_to_others(path, found)
        if why is None and stat.S_ISDIR(found.st_mode) and stat.S_IMODE(found.st_mode) != 0o700:
            path.chmod(0o700)
    except OSError:
        # A cache that cannot be had costs time, nothing else.
        return False
    if why is not None:
        _warn(str(path), why)
    return why is None and stat.S_ISDIR(found.st_mode)


def _open_to_others(path: Path, found: os.stat_result) -> str | None:
    """Return why other users could write to a folder, as text, from its file status; None if they cannot."""
    if stat.S_ISLNK(found.st_mode):
        return "it is a symbolic link"
    if found.st_uid != os.geteuid():
        return f"it belongs to another user ({found.st_uid})"
    # Whatever is there could be somebody else's by now, so the user has to look.
    if found.st_mode & 0o022:
        return "others can write into it; empty it and make it yours alone (chmod 700)"
    # Whoever can write into a folder above can put another one in its place.
    for above in path.resolve().parents:
        holder = above.stat()
        if holder.st_uid not in (0, _NOBODY, os.geteuid()):
            return f"{above} belongs to another user ({holder.st_uid})"
        if holder.st_mode & 0o002 and not holder.st_mode & stat.S_ISVTX:
            return f"everybody can write into {above}"
    return None


@lru_cache(maxsize=64)
def _warn(path: str, why: str) -> None:
    """Warn once that compiled programs cannot be kept in a folder; ``why``: the reason as text."""
    warn_user(
        f"compiled programs are neither read from {path} nor kept there: {why}. Every start compiles anew; "
        "QRSIM_CACHE_DIR names another place, QRSIM_COMPILATION_CACHE=off does without"
    )


def tidy(path: Path, largest: int = LARGEST_BYTES) -> None:
    """Delete abandoned temporary files and, beyond ``largest`` bytes in all, the least recently used files."""
    files: list[tuple[float, int, str]] = []
    with contextlib.suppress(OSError), os.scandir(path) as entries:
        for entry in entries:
            with contextlib.suppress(OSError):
                found = entry.stat(follow_symlinks=False)
                if not stat.S_ISREG(found.st_mode):
                    continue
                if _is_abandoned(entry.name, found.st_mtime):
                    os.unlink(entry.path)
                else:
                    files.append((found.st_mtime, found.st_size, entry.path))
    total = sum(size for _, size, _ in files)
    if total <= largest:
        return
    for _, size, name in sorted(files):
        with contextlib.suppress(OSError):
            os.unlink(name)
            total -= size
        # Further than need be, so that not every new file starts this again.
        if total <= 3 * largest // 4:
            return


def temporary(path: Path) -> Path:
    """Return the name of a temporary file next to ``path``, to be renamed once it is written."""
    return path.with_name(f"{path.stem}.{os.getpid()}.{time.monotonic_ns()}.tmp")


def _is_abandoned(name: str, modified: float) -> bool:
    """Return whether a temporary file is old (``modified``: time [s]) or the process in its name has ended."""
    if not (name.endswith(".tmp") or name.startswith("tmp")):
        return False
    if time.time() - modified > STALE_S:
        return True
    writer = name.split(".")[-3] if name.count(".") >= 3 else ""
    if not writer.isdigit():
        return False
    try:
        # Sends nothing; it only asks whether that process lives.
        os.kill(int(writer), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):
        return False
    return False
