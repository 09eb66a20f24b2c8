"""Archives of the cache: what was packed comes back, and nothing else gets in."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from qrsim.engine import cache, packing
from qrsim.engine.llvm import Binary
from qrsim.errors import UsageError

CODE = Binary(b"\x7fELF code", 64, b"text")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("QRSIM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("QRSIM_COMPILATION_CACHE", raising=False)
    return tmp_path / "cache" / "native"


@pytest.fixture
def archive(place: Path, tmp_path: Path) -> Path:
    """An archive of two programs; the cache is empty again."""
    cache.keep(("a",), CODE)
    cache.keep(("b",), cache.Known("0" * 64))
    path = tmp_path / "programs.tar.gz"
    assert packing.pack(path) == 2
    packing.clear()
    return path


def members(path: Path) -> dict[str, bytes]:
    with tarfile.open(path) as opened:
        return {member.name: opened.extractfile(member).read() for member in opened}  # type: ignore[union-attr]


def written(path: Path, files: dict[str, Any]) -> Path:
    """Write an archive of files, of which some are whole members."""
    with tarfile.open(path, "w") as opened:
        for name, content in files.items():
            member = content if isinstance(content, tarfile.TarInfo) else tarfile.TarInfo(name)
            if isinstance(content, bytes):
                member.size = len(content)
            opened.addfile(member, io.BytesIO(content) if isinstance(content, bytes) else None)
    return path


def test_there_and_back(place, archive):
    assert cache.look_up(("a",)) is None
    assert packing.contents()["native"].files == 0
    assert packing.unpack(archive) == 2
    assert cache.look_up(("a",)) == CODE
    assert cache.look_up(("b",)) == cache.Known("0" * 64)
    assert packing.contents()["native"].files == 2
    assert packing.clear()["native"].files == 2
    assert not list(place.iterdir())


def link(name: str) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.type, member.linkname = tarfile.SYMTYPE, "/etc/passwd"
    return member


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda files, first: files | {"../evil.bin": b"x"}, "a member '../evil.bin' that no cache has"),
        (lambda files, first: files | {"/etc/evil": b"x"}, "a member '/etc/evil'"),
        (lambda files, first: files | {"0" * 64 + ".bin": link("0" * 64 + ".bin")}, "that no cache has"),
        (lambda files, first: files | {"0" * 64 + ".bin": files[first]}, "is damaged or not the program"),
        (lambda files, first: files | {first: files[first][:-1]}, "is damaged or not the program"),
        (lambda files, first: files | {first: b""}, "is damaged or not the program"),
        (lambda files, first: {first: files[first]}, "its first member is no manifest.json"),
        (lambda files, first: files | {"manifest.json": b"{}"}, "its first member is no manifest.json"),
        (lambda files, first: files | {"manifest.json": b"[" * 5000}, "its first member is no manifest.json"),
        (lambda files, first: {}, "its first member is no manifest.json"),
    ],
)
def test_what_no_cache_has_is_refused_and_nothing_is_unpacked(
    place, archive, tmp_path, change: Callable[..., Any], message
):
    files = members(archive)
    first = next(name for name in files if name != "manifest.json")
    with pytest.raises(UsageError, match=message.replace(".", r"\.")):
        packing.unpack(written(tmp_path / "other.tar", change(files, first)))
    assert not list(place.iterdir())


def test_another_processor(place, archive, tmp_path):
    files = members(archive)
    files["manifest.json"] = json.dumps({"format": packing.FORMAT, "machine": "z80 +x llvm 1.0"}).encode()
    with pytest.raises(UsageError, match=r"packed on:    z80 llvm 1\.0\n  this machine: \w"):
        packing.unpack(written(tmp_path / "other.tar", files))


def test_larger_than_a_cache(place, archive, tmp_path, monkeypatch):
    monkeypatch.setattr(packing, "LARGEST_BYTES", 100)
    with pytest.raises(UsageError, match="is larger than a cache may be"):
        packing.unpack(archive)


@pytest.mark.parametrize("content", [None, b"", b"text", b"\x1f\x8b\x08\0\0\0"])
def test_no_archive(place, tmp_path, content):
    path = tmp_path / "programs.tar.gz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UsageError, match=r"there is no such file" if content is None else "not an archive of"):
        packing.unpack(path)


def test_cut_short(place, archive):
    whole = archive.read_bytes()
    for length in (len(whole) // 2, len(whole) - 60):
        archive.write_bytes(whole[:length])
        with pytest.raises(UsageError, match="cut short"):
            packing.unpack(archive)
    assert not list(place.iterdir())


def test_one_program_is_missing(place, archive, tmp_path):
    files = members(archive)
    files.popitem()
    with pytest.raises(UsageError, match="has 1 of 2 programs; it was cut short"):
        packing.unpack(written(tmp_path / "other.tar", files))


def test_programs_of_another_processor_are_not_packed(place, tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "_origin", lambda rooms: {"machine": "z80"})
    cache.keep(("a",), CODE)
    with pytest.raises(UsageError, match="no compiled program for this processor"):
        packing.pack(tmp_path / "programs.tar")


def test_switched_off(monkeypatch, tmp_path):
    monkeypatch.setenv("QRSIM_COMPILATION_CACHE", "off")
    assert packing.contents() == {}
    with pytest.raises(UsageError, match="QRSIM_COMPILATION_CACHE is off"):
        packing.pack(tmp_path / "programs.tar")


def test_the_commands(place, tmp_path, capsys, refused):
    from qrsim import cli

    cache.keep(("a",), CODE)
    archive = str(tmp_path / "programs.tar.gz")
    assert cli.main(["cache", "pack", archive]) == 0
    assert cli.main(["cache", "clear"]) == 0
    assert cli.main(["cache", "unpack", archive]) == 0
    assert cli.main(["cache", "info"]) == 0
    capsys.readouterr()
    assert cli.main(["cache", "info", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["kinds"]["native"] == {
        "folder": str(place),
        "files": 1,
        "size_bytes": next(place.iterdir()).stat().st_size,
    }
    refused(["cache", "unpack", str(tmp_path / "nothing.tar")], "there is no such file")
    refused(["cache", "claer"], "did you mean 'clear'?")
