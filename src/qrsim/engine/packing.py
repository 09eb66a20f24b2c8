"""The cache of compiled programs as a whole: its contents, and archives that carry it to another machine."""

from __future__ import annotations

import io
import json
import re
import tarfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from qrsim.engine import cache
from qrsim.engine.folders import LARGEST_BYTES, cache_folder, private
from qrsim.engine.llvm.compiler import machine_name
from qrsim.errors import RunError, UsageError, did_you_mean_file, os_error_as
from qrsim.files import Content
from qrsim.files.atomic import write_atomically

# Folders of the cache: programs of the package's own code generator, and those that XLA compiled.
KINDS = ("native", "compiled")
FORMAT = "qrsim cache 1"
MANIFEST = "manifest.json"
_NAME = re.compile(r"[0-9a-f]{64}\.bin")
_LARGEST_MANIFEST = 10_000


@dataclass(frozen=True)
class Contents:
    """Files of one kind.

    Attributes:
        folder: where they are.
        files: how many.
        size_bytes: of all together.
    """

    folder: Path
    files: int
    size_bytes: int


def processor() -> str:
    """Return a text that identifies this processor: its name, features and the compiler version."""
    return machine_name()


def contents() -> dict[str, Contents]:
    """Return the number and size of cached program files by kind; {} if QRSIM_COMPILATION_CACHE is off."""
    found = {}
    for kind in KINDS if cache.folder() is not None else ():
        sizes = [path.stat().st_size for path in _cache_files(kind)]
        found[kind] = Contents(cache_folder() / kind, len(sizes), sum(sizes))
    return found


def clear() -> dict[str, Contents]:
    """Delete every file of the cache, and return the number and size of the deleted files by kind.

    Raises:
        RunError: a file cannot be deleted.
    """
    before = contents()
    for kind in before:
        for path in _cache_files(kind):
            with os_error_as(RunError, f"{path}"):
                path.unlink(missing_ok=True)
    return before


def _cache_files(kind: str) -> list[Path]:
    """Return the files of a kind, "native" or "compiled" (by XLA), in the cache folder."""
    folder = cache_folder() / kind
    if not folder.is_dir() or folder.is_symlink():
        return []
    return sorted(path for path in folder.iterdir() if path.is_file() and not path.is_symlink())


def pack(path: Path) -> int:
    """Write this processor's cached programs to a tar archive (``.gz``, ``.tgz``: compressed); return their number.

    Returns:
        The number of programs.

    Raises:
        UsageError: the cache is switched off, or has no program for this processor.
        RunError: the archive cannot be written.
    """
    _place()
    entries = {}
    for file in _cache_files("native"):
        data = _whole(file)
        if data is not None and data[0]["origin"]["machine"] == machine_name():
            entries[file.name] = data[1]
    if not entries:
        raise UsageError(f"{cache_folder()}: there is no compiled program for this processor; fly a scenario first")
    manifest = json.dumps({"format": FORMAT, "machine": machine_name(), "programs": len(entries)}, indent=2).encode()
    buffer = io.BytesIO()
    # The default level 9 takes four times as long as level 6 and saves 0.4 %.
    how: dict[str, Any] = {"mode": "w:gz", "compresslevel": 6} if path.suffix in (".gz", ".tgz") else {"mode": "w"}
    with tarfile.open(fileobj=buffer, **how) as archive:
        for name, content in {MANIFEST: manifest, **entries}.items():
            member = tarfile.TarInfo(name)
            member.size, member.mode = len(content), 0o600
            archive.addfile(member, io.BytesIO(content))
    with os_error_as(RunError, f"{path}"):
        write_atomically(path, buffer.getbuffer())
    return len(entries)


def _whole(path: Path) -> tuple[Content, bytes] | None:
    """Return the header and the whole content of a cache file; None if it is damaged or not a cache file."""
    try:
        content = cache.file_bytes(path)
        return None if content is None else (_checked(path.name, content), content)
    except (OSError, ValueError):
        return None


def _checked(name: str, content: bytes) -> Content:
    """Return the header of a file in an archive; raise ValueError if it is damaged or wrongly named.

    Raises:
        ValueError: it is damaged, or has another name than its own.
    """
    header = cache.opened(content)[0]
    origin = header["origin"]
    if name != f"{header['key']}{cache.SUFFIX}" or not isinstance(origin, dict) or "machine" not in origin:
        raise ValueError("another program's name")
    return header


def unpack(path: Path) -> int:
    """Copy the programs of an archive to the cache once all have passed checks; return their number.

    Returns:
        The number of programs.

    Raises:
        UsageError: it is no archive of a cache, is damaged, or is for another processor.
    """
    place = _place()
    try:
        with tarfile.open(path, "r:*") as archive:
            entries = _entries(path, archive)
    except FileNotFoundError:
        raise UsageError(f"{path}: there is no such file{did_you_mean_file(path)}") from None
    except (OSError, EOFError, zlib.error, tarfile.TarError):
        raise UsageError(f"{path}: not an archive of 'qrsim cache pack', or cut short") from None
    for name, content in entries.items():
        cache.write_file(place / name, content)
    missing = [name for name in entries if not (place / name).is_file()]
    if missing:
        raise RunError(f"{place}: {len(missing)} of {len(entries)} programs could not be written")
    return len(entries)


def _entries(path: Path, archive: tarfile.TarFile) -> dict[str, bytes]:
    """Return the content of each program file in an archive, by file name."""
    first = archive.next()
    manifest = _read_manifest(path, archive, first)
    if manifest["machine"] != machine_name():
        raise UsageError(
            f"{path}: packed on another processor or with another compiler.",
            f"  packed on:    {_processor(str(manifest['machine']))}",
            f"  this machine: {_processor(machine_name())}",
        )
    entries: dict[str, bytes] = {}
    left = LARGEST_BYTES
    while (member := archive.next()) is not None:
        # Only names that a cache uses: no member may be written anywhere else.
        if not member.isreg() or not _NAME.fullmatch(member.name):
            raise UsageError(f"{path}: has a member '{member.name[:100]}' that no cache has; nothing was unpacked")
        left -= member.size
        if member.size > cache.LARGEST_FILE or left < 0:
            raise UsageError(f"{path}: is larger than a cache may be ({LARGEST_BYTES // 2**20} MiB)")
        content = _read_member(archive, member)
        try:
            machine = _checked(member.name, content)["origin"]["machine"]
        except ValueError:
            machine = None
        if machine != manifest["machine"]:
            raise UsageError(f"{path}: {member.name} is damaged or not the program it claims to be")
        entries[member.name] = content
    if len(entries) != manifest.get("programs"):
        raise UsageError(f"{path}: has {len(entries)} of {manifest.get('programs')} programs; it was cut short")
    return entries


def _read_manifest(path: Path, archive: tarfile.TarFile, member: tarfile.TarInfo | None) -> dict[str, object]:
    """Return the manifest of an archive; raise UsageError if it has none."""
    found = None
    if member is not None and member.isreg() and member.name == MANIFEST and member.size <= _LARGEST_MANIFEST:
        try:
            found = json.loads(_read_member(archive, member))
        except (ValueError, RecursionError):
            found = None
    if not isinstance(found, dict) or found.get("format") != FORMAT or "machine" not in found:
        raise UsageError(f"{path}: not an archive of 'qrsim cache pack': its first member is no {MANIFEST} of one")
    return found


def _read_member(archive: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    """Return the content of a file in an archive."""
    file = archive.extractfile(member)
    return b"" if file is None else file.read()


def _processor(machine: str) -> str:
    """Return processor and LLVM version from ``machine``, the text of ``processor``, without CPU features."""
    words = machine.split()
    return " ".join([*words[:1], *words[-2:]])[:200]


def _place() -> Path:
    """Return the folder of cached programs; raise UsageError if the cache is off or the folder is not private.

    Raises:
        UsageError: nothing is kept, or the folder may not be used.
    """
    place = cache.folder()
    if place is None:
        raise UsageError("QRSIM_COMPILATION_CACHE is off, so there is no cache")
    if not private(place):
        raise UsageError(f"{place}: not a folder that is this user's alone")
    return place
