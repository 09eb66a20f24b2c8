"""Files that a user names: regular ones only, and never a wait."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from qrsim.cli import main
from qrsim.engine.folders import cache_folder
from qrsim.errors import QrsimError, UsageError, readable
from qrsim.files import recordings
from qrsim.files.code import anchored
from qrsim.files.user_files import open_file, read_bytes, read_text
from qrsim.interface.policies import load_function
from qrsim.runs import open_run
from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.flight_logs import read_log


@pytest.fixture
def odd(tmp_path: Path) -> Iterator[dict[str, Path]]:
    """Paths of what is no regular file, and of one that is too large; the large one takes no room on the disk."""
    pipe, large, plug = tmp_path / "pipe", tmp_path / "large", tmp_path / "plug"
    os.mkfifo(pipe)
    with large.open("wb") as file:
        file.truncate(2**31)
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(str(plug))
    yield {"pipe": pipe, "large": large, "socket": plug, "folder": tmp_path, "device": Path("/dev/zero")}
    listening.close()


def test_only_regular_files_are_opened(odd: dict[str, Path]) -> None:
    said = {}
    for name, path in odd.items():
        with pytest.raises(OSError) as caught:  # noqa: PT011 (its words are compared below)
            open_file(path)
        said[name] = caught.value.strerror
    assert said == {
        "pipe": "it is a pipe; expected a file",
        "large": "it has 2 GB; allowed: up to 1 GB",
        "socket": "No such device or address",
        "folder": "Is a directory",
        "device": "it is a device; expected a file",
    }
    with pytest.raises(OSError, match="its name has a null byte"):
        open_file("a\0b")


def test_content_is_read_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"\xef\xbb\xbfa\r\nb")
    assert read_text(path) == "a\r\nb"
    assert read_bytes(path, 7) == b"\xef\xbb\xbfa\r\nb"
    with pytest.raises(OSError, match="it has 7 bytes; allowed: up to 6 bytes"):
        read_bytes(path, 6)
    path.write_bytes(b"a\n\xff")
    with pytest.raises(OSError, match="byte 0xff in line 2 is no UTF-8 text"):
        read_text(path)


FLEET = {"controller": {"type": "waypoint", "feed": "truth"}, "vehicles": [{"position_ned": [0.0, 0.0, -9.0]}]}


def scenario(world: dict[str, Any], **fleet: Any) -> dict[str, Any]:
    return {"name": "x", "world": world, "fleets": {"a": {**FLEET, **fleet}}}


def wind(path: Path) -> None:
    load_scenario(scenario({"wind": {"type": "series", "file": str(path)}}))


def orbits(path: Path) -> None:
    load_scenario(scenario({"sky": {"orbits": {"type": "sp3", "file": str(path)}}}))


def fence(path: Path) -> None:
    load_scenario(scenario({"area": {"type": "fence", "file": str(path), "z_min": -50.0, "z_max": 0.0}}))


def plan(path: Path) -> None:
    load_scenario(scenario({}, vehicles=[{"plan": {"file": str(path)}}]))


def vehicle(path: Path) -> None:
    load_scenario(scenario({}, vehicle={"file": str(path)}))


def run_info(path: Path) -> None:
    folder = path.parent / "run"
    folder.mkdir()
    (folder / "run.json").symlink_to(path)
    open_run(folder)


def named(ending: str, read: Any) -> Any:
    def reader(path: Path) -> None:
        link = path.parent / f"link{ending}"
        link.symlink_to(path)
        read(link)

    return reader


def study(path: Path) -> None:
    from qrsim.studies.sweep.study import load_study

    load_study(str(path))


def commands(path: Path) -> None:
    from qrsim.apps.openloop.command_file import read_commands

    read_commands(path, "si")


READERS = [
    wind, orbits, plan, vehicle, read_log, commands, run_info, named(".kml", fence), named(".yaml", load_scenario),
    named(".yaml", study), named(".py", lambda path: load_function("policy", f"{path}:fly")),
]  # fmt: skip


@pytest.mark.parametrize("reader", range(len(READERS)))
def test_whoever_reads_a_file_refuses_pipes(odd: dict[str, Path], reader: int) -> None:
    """Opened as usual, each of these would wait for ever."""
    with pytest.raises(QrsimError) as caught:
        READERS[reader](odd["pipe"])
    assert len(str(caught.value).splitlines()) <= 2


@pytest.mark.parametrize("name", ["large", "device"])
def test_a_scenario_that_is_too_large_or_a_device(odd: dict[str, Path], name: str, capsys: Any) -> None:
    link = odd["folder"] / "s.yaml"
    link.symlink_to(odd[name])
    assert main(["show", str(link)]) == 2
    assert "cannot be read: it " in capsys.readouterr().err


def test_arguments_that_are_no_text(capsys: Any) -> None:
    assert main(["show", os.fsdecode(b"a\xff.yaml")]) == 2
    assert capsys.readouterr().err.splitlines() == [r"error: qrsim: the argument 'a\udcff.yaml' is no text in UTF-8"]


@pytest.mark.parametrize(("size_mb", "read"), [(15.9, True), (16.1, False)])
def test_a_text_has_sixteen_megabytes_at_most(size_mb: float, read: bool, tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    with path.open("wb") as file:
        file.truncate(round(size_mb * 2**20))
    if read:
        assert len(read_text(path)) == round(size_mb * 2**20)
    else:
        with pytest.raises(OSError, match=r"it has 16\.1 MB; allowed: up to 16 MB"):
            read_text(path)


def test_a_home_that_nobody_has_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    nowhere = "~nobody-at-all/x"
    for variable in ("QRSIM_DATA_DIR", "QRSIM_CACHE_DIR"):
        monkeypatch.setenv(variable, nowhere)
    assert recordings.data_folder() == cache_folder() == Path.cwd() / nowhere
    assert anchored(f"{nowhere}.py:fly", Path("/a")) == f"/a/{nowhere}.py:fly"
    with pytest.raises(UsageError, match="cannot be read"), readable(nowhere):
        open_file(nowhere)
