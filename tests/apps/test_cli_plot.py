"""``qrsim plot``: what it draws from, where it writes, and what it says where it cannot."""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path

import pytest

from qrsim import cli


@pytest.fixture
def copy(flown, tmp_path) -> Path:
    """A copy of the flown run, without its figure."""
    folder = tmp_path / "run"
    shutil.copytree(flown.folder, folder)
    (folder / "figure.png").unlink()
    return folder


def change_info(folder: Path, **changes: object) -> None:
    path = folder / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def test_the_default_target_is_the_figure_of_the_run(copy, flown, capsys):
    assert cli.main(["plot", str(copy)]) == 0
    assert capsys.readouterr().out == f"{copy / 'figure.png'}\n"
    drawn = (copy / "figure.png").read_bytes()
    assert drawn.startswith(b"\x89PNG\r\n\x1a\n")
    assert struct.unpack(">II", drawn[16:24]) == (1430, 990)
    # It is the picture that the run itself made.
    assert drawn == (flown.folder / "figure.png").read_bytes()


@pytest.mark.parametrize("flag", ["-o", "--output"])
def test_another_target(flag, copy, tmp_path, capsys):
    target = tmp_path / "first.pdf"
    assert cli.main(["plot", str(copy), flag, str(target)]) == 0
    assert capsys.readouterr().out == f"{target}\n"
    assert target.read_bytes().startswith(b"%PDF-")
    assert not (copy / "figure.png").exists()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("x.jpg", "x.jpg: cannot draw '.jpg'; did you mean 'png'?"),
        ("x", "x: the name of a picture needs an ending; known: png, pdf, svg"),
    ],
)
def test_unknown_endings(name, message, flown, tmp_path, refused):
    refused(["plot", str(flown.folder), "-o", str(tmp_path / name)], message)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_and_a_folder_that_is_no_run(flown, tmp_path, refused):
    refused(["plot", str(tmp_path / "nothing")], "no run at", "there is no such folder")
    refused(["plot", str(tmp_path)], f"{tmp_path} is not a run folder: it has no run.json")
    refused(["plot", str(flown.folder / "truth")], f"it has no run.json; the run is {flown.folder}")
    refused(["plot", str(flown.folder.parent)], "runs inside it: run")


@pytest.mark.parametrize(("name", "reason"), [("nowhere/x.png", "No such file"), ("folder.png", "Is a directory")])
def test_a_target_that_cannot_be_written(name, reason, flown, tmp_path, refused):
    (tmp_path / "folder.png").mkdir()
    target = tmp_path / name
    refused(["plot", str(flown.folder), "-o", str(target)], f"cannot write {target}: {reason}", code=1)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.png"]


def test_a_run_killed_before_its_first_flush(copy, refused):
    """The parts without rows are there, and nothing else."""
    for stream in ("truth", "measurements", "commands", "wind", "events"):
        for part in list((copy / stream).iterdir()):
            if part.name != "part-00000.parquet":
                part.unlink()
    parts = dict.fromkeys(("truth", "measurements", "commands", "wind", "events"), 1)
    change_info(copy, state="running", ticks=0, parts=parts, ended=None)
    refused(["plot", str(copy)], "nothing to draw, because no tick was recorded (state: running)", code=1)
    assert not (copy / "figure.png").exists()


def test_a_damaged_log_names_the_file(copy, refused):
    part = copy / "wind" / "part-00001.parquet"
    part.write_bytes(part.read_bytes()[:-20])
    refused(["plot", str(copy)], "wind/part-00001.parquet", "cannot be read", code=1)


def test_a_run_of_a_later_version(copy, refused):
    change_info(copy, format=99)
    refused(["plot", str(copy)], "has the run folder format 99", code=1)


def test_a_missing_argument(capsys):
    assert cli.main(["plot"]) == 2
    assert "RUN" in capsys.readouterr().err
