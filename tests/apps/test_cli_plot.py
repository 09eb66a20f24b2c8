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


@pytest.mark.long
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


# ---------------------------------------------------------------- panels


def test_panels_have_a_file_of_their_own(copy, capsys):
    words = ["--panel", "truth.position_ned.z", "--panel", "measurements.gnss.position_ned.x, truth.position_ned.x"]
    assert cli.main(["plot", str(copy), *words, "--from", "2", "--to", "8", "--vehicle", "pelicans_1"]) == 0
    assert capsys.readouterr().out == f"{copy / 'panels.png'}\n"
    width, height = struct.unpack(">II", (copy / "panels.png").read_bytes()[16:24])
    assert (width, height) == (1320, 660)
    assert not (copy / "figure.png").exists()


def test_where_the_picture_is_as_json(flown, tmp_path, capsys):
    target = tmp_path / "x.svg"
    assert cli.main(["plot", str(flown.folder), "--panel", "wind.gust_ned", "--out", str(target), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"run": str(flown.folder), "figure": str(target)}
    assert b"<svg" in target.read_bytes()


def test_the_list_of_quantities(flown, capsys):
    assert cli.main(["plot", str(flown.folder), "--list"]) == 0
    rows = [line.split(maxsplit=2) for line in capsys.readouterr().out.splitlines()]
    assert ["truth.position_ned.z", "m", "third axis: down"] in rows
    assert cli.main(["plot", str(flown.folder), "--list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert {"quantity": "truth.position_ned.z", "unit": "m", "doc": "third axis: down"} in listed
    assert len(listed) == len({item["quantity"] for item in listed}) == 121


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--panel", "truth.positoin_ned.z"], "did you mean 'truth.position_ned.z'?"),
        (["--panel", "truth.position_ned.x,truth.thrust"], "truth.position_ned.x is in m and truth.thrust is in N"),
        (["--panel", "truth.thrust", "--vehicle", "pelican_1"], "no vehicle 'pelican_1'; did you mean 'pelicans_1'?"),
        (["--panel", "truth.thrust", "--from", "11"], "no tick from 11 s; the log goes from 0 s to 10 s"),
        (["--panel", "truth.thrust", "--from", "3", "--to", "2"], "--from 3 is after --to 2"),
        (["--panel", "truth.thrust", "--to", "nan"], "--to nan: expected a number of seconds"),
        (["--from", "3", "--vehicle", "pelicans_1"], "--vehicle, --from: only for panels"),
        (["--list", "--panel", "truth.thrust"], "--list draws nothing"),
    ],
)
def test_wrong_panels(words, part, flown, refused):
    refused(["plot", str(flown.folder), *words], part)
