"""Noise of an inertial sensor from a log at rest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import qrsim
from qrsim.cli import main
from qrsim.errors import LogError
from qrsim.studies.flight_logs.inertial import Readings, read_inertial
from qrsim.studies.identify.at_rest import allan_variance, at_rest, noise_of, sensor_of, shapes

RATE = 50.0
HEADER = "time [s],gyroscope_x [rad/s],gyroscope_y [rad/s],gyroscope_z [rad/s]"


def white(seconds: float, size: float = 1e-3, seed: int = 1) -> Any:
    """Return white noise (T, 3) whose N is ``size``."""
    return size * np.sqrt(RATE) * np.random.default_rng(seed).standard_normal((round(seconds * RATE), 3))


def table(path: Path, gyroscope: Any, header: str = HEADER) -> str:
    """Write readings, and return the path."""
    rows = np.column_stack([np.arange(len(gyroscope)) / RATE, gyroscope])
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.9g")
    return str(path)


def test_the_allan_variance_is_that_of_allantools() -> None:
    """Of white noise and a walk, over windows of 1 to 1000 readings."""
    allantools = pytest.importorskip("allantools", reason="needs allantools: pip install allantools")
    values = white(200.0) + np.cumsum(white(200.0, 1e-5, 2), axis=0)
    lengths = np.array([1, 4, 33, 400, 1000])
    found = allan_variance(values, lengths)
    for axis in range(3):
        _, deviation, _, _ = allantools.oadev(values[:, axis], rate=RATE, data_type="freq", taus=lengths / RATE)
        assert np.sqrt(found[:, axis]) == pytest.approx(deviation, rel=1e-9)


def test_shapes_are_those_of_the_standard() -> None:
    """IEEE Std 952: N^2/t, K^2 t/3; flicker noise is flat at (2 ln 2/pi) B^2 within what three processes can do."""
    windows = np.array([20.0, 100.0, 300.0])
    found = shapes(windows)
    assert found[:, 0] == pytest.approx([0.05, 0.01, 1.0 / 300.0])
    assert found[:, 2] == pytest.approx([20.0 / 3.0, 100.0 / 3.0, 100.0])
    assert found[:, 1] == pytest.approx([0.4413] * 3, rel=0.12)


def test_noise_is_found_again() -> None:
    """Twenty minutes of N = 0.001 and K = 0.0001: both within their intervals; no flicker noise."""
    walk = np.cumsum(white(1200.0, 1e-4, 7) / RATE, axis=0)
    found = noise_of(white(1200.0) + walk + np.array([0.1, 0.0, -0.2]), 1.0 / RATE)
    noise, flicker, walked = (found.terms[name] for name in ("noise", "bias_instability", "random_walk"))
    assert noise.low < 1e-3 < noise.high
    assert noise.high - noise.low < 0.05e-3
    assert walked.low < 1e-4 < walked.high
    assert walked.seen
    assert not flicker.seen
    assert found.mean == pytest.approx([0.1, 0.0, -0.2], abs=0.02)
    sensor = sensor_of({"gyroscope": found}, "bmi088")
    assert sensor == {
        "type": "imu",
        "preset": "bmi088",
        "gyroscope_noise": pytest.approx(1e-3, rel=0.03),
        "gyroscope_random_walk": pytest.approx(1e-4, rel=0.3),
    }


@pytest.mark.long
def test_intervals_hold_the_truth() -> None:
    """Of 40 logs of ten minutes those of N hold it in 34 and more (95 %, at 99.9 %), those of K in 30 and more."""
    inside, flicker = np.zeros(2, int), 0
    for seed in range(40):
        walk = np.cumsum(white(600.0, 2e-4, 1000 + seed) / RATE, axis=0)
        terms = noise_of(white(600.0, 1e-3, seed) + walk, 1.0 / RATE).terms
        inside += [terms[name].low < true < terms[name].high for name, true in (("noise", 1e-3), ("random_walk", 2e-4))]
        flicker += terms["bias_instability"].seen
    assert inside[0] >= 34
    assert inside[1] >= 30
    assert flicker <= 6


@pytest.mark.long
def test_a_preset_is_found_again() -> None:
    """A chip of the preset icm42688p for an hour; its data sheet has 0.0028 deg/s/sqrt(Hz) and 70 ug/sqrt(Hz)."""
    from evidence import imu

    sensor = imu.preset("icm42688p", 0.02)
    taken = imu.readings(sensor, round(3600.0 * RATE), 1)
    gyroscope, accelerometer = (noise_of(np.asarray(taken[kind][:, 0], float), 0.02) for kind in imu.KINDS)
    # One-sided densities of a data sheet are sqrt(2) times the N of the standard.
    assert gyroscope.terms["noise"].value == pytest.approx(np.radians(0.0028) / np.sqrt(2.0), rel=0.02)
    assert accelerometer.terms["noise"].value == pytest.approx(70e-6 * 9.80665 / np.sqrt(2.0), rel=0.02)
    assert gyroscope.terms["bias_instability"].seen


def test_only_the_part_at_rest_counts() -> None:
    """Shaken for 10 s, at rest for 80 s, turned for 20 s."""
    values = white(110.0)
    values[:500] *= 30.0
    values[4500:] += 0.5
    kept, (first, last) = at_rest(Readings(1.0 / RATE, {"gyroscope": values}), "still.csv")
    assert (first, last) == (10.0, 90.0)
    assert len(kept.values["gyroscope"]) == 4000


@pytest.mark.long
def test_the_command_writes_a_sensor_that_flies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A CSV in deg/s; what it writes is a sensor of a scenario."""
    monkeypatch.chdir(tmp_path)
    log = table(tmp_path / "still.csv", np.degrees(white(120.0)), HEADER.replace("rad/s", "deg/s"))
    assert main(["identify", log, "--imu", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["noise"]["gyroscope"]["noise"]["value"] == pytest.approx(1e-3, rel=0.05)
    assert said["at_rest_s"] == [0.0, 120.0]
    assert (tmp_path / "my_imu.png").stat().st_size > 10_000
    sensor = yaml.safe_load((tmp_path / "my_imu.yaml").read_text("utf-8"))["imu"]
    assert sensor["gyroscope_noise"] == pytest.approx(1e-3, rel=0.05)
    fleet = {
        "controller": {"feed": "truth", "type": "cascade"},
        "sensors": {"imu": sensor},
        "vehicles": [{"position_ned": [0, 0, -10]}],
    }
    made = qrsim.load_scenario({"name": "one", "fleets": {"a": fleet}}, quiet=True).world()
    assert float(made.fleets[0].sensors[0].gyroscope_noise) == pytest.approx(1e-3, rel=0.05)
    assert main(["identify", log, "--imu"]) == 2
    assert "exists already" in capsys.readouterr().err
    assert main(["identify", log, "--imu", "--overwrite"]) == 0
    assert "gyroscope_noise" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "code", "message"),
    [
        ("short", 1, "at rest for 30 s at most, of 30 s"),
        ("moved", 1, "at rest for"),
        ("constant", 1, "gyroscope_y is constant"),
        ("uneven", 1, "the readings need one rate"),
        ("unit", 1, "expected a unit, 'gyroscope_x [rad/s]' or one of rad/s, deg/s, mrad/s"),
        ("name", 1, "there is no column 'gyroscope_z'; did you mean 'gyroscop_z'?"),
        ("nan", 1, "gyroscope_x: reading 8 is not finite"),
        ("text", 1, "line 5: expected a number in each of time"),
        ("few", 1, "40 readings; expected 100 and more"),
        ("none", 2, "no such file"),
        ("two", 2, "--imu: expected one LOG, found 2"),
    ],
)
def test_wrong_logs_end_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    change: str,
    code: int,
    message: str,
) -> None:
    """Nothing is written."""
    monkeypatch.chdir(tmp_path)
    seconds = {"short": 30.0, "few": 0.8}.get(change, 100.0)
    values, header = white(seconds), HEADER
    if change == "moved":
        values *= np.where(np.arange(len(values)) // 1000 % 2, 20.0, 1.0)[:, None]
    if change == "constant":
        values[:, 1] = 0.1
    if change == "nan":
        values[7, 0] = np.nan
    header = header.replace("gyroscope_x [rad/s]", "gyroscope_x [rpm]") if change == "unit" else header
    header = header.replace("gyroscope_z", "gyroscop_z") if change == "name" else header
    path = tmp_path / "still.csv"
    log = table(path, values, header)
    if change == "uneven":
        text = path.read_text("utf-8").splitlines()
        path.write_text("\n".join([text[0], *[row for i, row in enumerate(text[1:]) if i % 10 < 5]]), "utf-8")
    if change == "text":
        lines = path.read_text("utf-8").splitlines()
        lines[4] = "0.06,a,b,c"
        path.write_text("\n".join(lines), "utf-8")
    words = {"none": ["nothing.csv"], "two": [log, log]}.get(change, [log])
    assert main(["identify", *words, "--imu"]) == code
    said = capsys.readouterr().err.strip()
    assert message in said
    assert "\n" not in said
    assert not (tmp_path / "my_imu.yaml").exists()


def test_a_log_of_px4_has_readings(recordings: Path) -> None:
    """Both recorded logs have sensor_combined; neither stands still for a minute."""
    found = read_inertial(recordings / "px4" / "sample_log_small.ulg")
    assert set(found.values) == {"gyroscope", "accelerometer"}
    assert found.values["accelerometer"].mean(axis=0)[2] == pytest.approx(-9.8, abs=0.5)
    with pytest.raises(LogError, match="at rest for"):
        at_rest(found, "sample_log_small.ulg")
