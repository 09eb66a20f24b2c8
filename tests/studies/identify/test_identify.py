"""Constants are found again, said when they cannot be, and flown by scenarios."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.studies.flight_logs.log_writing import flown, write_csv

from qrsim import cli
from qrsim.core.tree import replace
from qrsim.errors import UsageError
from qrsim.models.vehicles.separate_quadrotor import SeparateQuadrotor
from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.flight_logs import FlightLog, read_log
from qrsim.studies.identify.constants import CONSTANTS, channels_of, lacking
from qrsim.studies.identify.fit import Answer, Prior, Question, solve
from qrsim.studies.identify.problem import cut

TRUTH = {"kpq1": 150.0, "kpq2": -20.0, "kq0": -2.8e-4, "kq1": 210.0, "kq2": -28.0, "kr1": -6.5}
START = {name: float(getattr(SeparateQuadrotor(), name)) for name in CONSTANTS}
ROTATION = ("kpq0", "kpq1", "kpq2", "kq0", "kq1", "kq2", "kr0", "kr1")
LEFT_OUT = ("velocity_north", "velocity_east", "velocity_down", "throttle", "battery")


@pytest.fixture(scope="module")
def log_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rotation of 30 s, whose yaw is not commanded."""
    signals = flown(30.0, vehicle=replace(SeparateQuadrotor(), **TRUTH), still="yaw")
    kept = {name: values for name, values in signals.items() if name not in LEFT_OUT}
    return write_csv(tmp_path_factory.mktemp("logs") / "turns.csv", kept)


@pytest.fixture(scope="module")
def log(log_file: Path) -> FlightLog:
    return read_log(log_file)


@pytest.fixture(scope="module")
def answer(log: FlightLog) -> Answer:
    return solve(Question(ROTATION, START, separate=True), [cut(log, 2.0, 0.0, 0.6)])


@pytest.mark.long
def test_constants_of_both_axes_are_found(answer: Answer) -> None:
    """With a noise of 1 mrad, to 2 %; each 95 % interval, three times as wide, holds the truth."""
    for name in ("kpq0", "kpq1", "kpq2", "kq0", "kq1", "kq2"):
        truth = TRUTH.get(name, START[name])
        low, high = answer.covariance.interval(name)
        assert answer.values[name] == pytest.approx(truth, rel=0.02), name
        assert abs(answer.values[name] - truth) < 1.5 * (high - low), name
        assert name in answer.estimated
    assert answer.nuisances[0]["delay"] == pytest.approx(0.0, abs=2e-3)


@pytest.mark.long
def test_an_axis_that_does_not_move_stays_at_its_prior_and_that_is_said(answer: Answer) -> None:
    assert "kr0" in answer.left
    assert answer.values["kr0"] == pytest.approx(START["kr0"], rel=0.01)


@pytest.mark.long
def test_the_held_out_part_is_not_used(log: FlightLog, answer: Answer) -> None:
    rows = round(0.6 * len(log.time))
    spoilt = replace(log, signals={name: np.where(np.arange(len(v)) < rows, v, 9.0) for name, v in log.signals.items()})
    again = solve(Question(ROTATION, START, separate=True), [cut(spoilt, 2.0, 0.0, 0.6)])
    assert again.values == answer.values


@pytest.mark.long
def test_a_narrow_prior_holds_a_constant(log: FlightLog) -> None:
    held = Prior(179.0, 1e-4)
    question = Question(ROTATION, START | {"kpq1": 179.0}, True, {"kpq1": held}, delay=0.0)
    found = solve(question, [cut(log, 2.0, 0.0, 0.6)])
    assert found.values["kpq1"] == pytest.approx(179.0, abs=0.01)


@pytest.mark.long
def test_the_command_writes_a_vehicle_that_scenarios_fly(
    log_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine.yaml"
    words = ["identify", str(log_file), "--separate", "--horizon", "2", "--fit", ",".join(ROTATION), "-o", str(out)]
    assert cli.main(words) == 0
    printed = capsys.readouterr().out
    assert "kr0 -0.004818, kr1 -5.089: held at its start: yaw_rate_command is constant" in printed
    assert "held-out" in printed
    folder = tmp_path / "mine_report"
    report = (folder / "report.md").read_text()
    for name in ("constants.png", "held_out_0.png", "residuals_0.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
        assert name in report
    assert "| kpq1 |" in report
    fleet = next(iter(load_scenario("hover_ideal").spec.fleets))
    scenario = load_scenario("hover_ideal", [f"fleets.{fleet}.vehicle={{file: {out}}}"])
    vehicle = scenario.world().fleets[0].vehicle
    assert float(vehicle.kq1) == pytest.approx(TRUTH["kq1"], rel=0.02)
    assert "file:" not in scenario.to_yaml()


@pytest.mark.parametrize(
    ("extra", "parts"),
    [
        (["--fit", "kpq4"], ("no constant is called 'kpq4'", "kpq")),
        (["--fit", "kq1"], ("'kq1' is of pitch alone; add --separate",)),
        (["--mass", "-1"], ("--mass -1: expected a mass above 0 kg",)),
        (["--mass", "1900"], ("--mass 1900: too heavy for a quadrotor", "1900 g are 1.9 kg")),
        (["--mass", "1.7:x"], ("--mass 1.7:x: 'x' is not a finite number",)),
        (["--prior", "kpq1=180"], ("expected NAME=VALUE:STD",)),
        (["--train", "1.5"], ("--train 1.5: expected a share",)),
        (["--from", "50"], ("no rows from 50 to inf s",)),
        (["--ignore", "rol"], ("no measured signal is called 'rol'; did you mean 'roll'",)),
    ],
)
def test_wrong_usage(
    extra: list[str], parts: tuple[str, ...], log_file: Path, refused: Callable[..., None], tmp_path: Path
) -> None:
    refused(["identify", str(log_file), "--quiet", "-o", str(tmp_path / "v.yaml"), *extra], *parts)


def test_a_constant_without_its_signals(log_file: Path, refused: Callable[..., None], tmp_path: Path) -> None:
    said = ("'kuv' needs velocity_north, velocity_east, velocity_down, throttle", "there: roll")
    refused(["identify", str(log_file), "--quiet", "-o", str(tmp_path / "v.yaml"), "--fit", "kuv"], *said, code=1)


def test_a_file_is_not_overwritten(log_file: Path, refused: Callable[..., None], tmp_path: Path) -> None:
    out = tmp_path / "v.yaml"
    out.write_text("mine")
    refused(["identify", str(log_file), "-o", str(out)], "exists already; --overwrite replaces it")
    assert out.read_text() == "mine"


def test_a_missing_signal_is_named(refused: Callable[..., None], tmp_path: Path) -> None:
    signals = flown(6.0)
    path = write_csv(tmp_path / "log.csv", {name: v for name, v in signals.items() if name != "pitch_rate"})
    refused(
        ["identify", str(path), "--quiet", "-o", str(tmp_path / "v.yaml")],
        "the rotation of a vehicle needs pitch_rate",
        "there: roll, pitch, yaw",
        code=1,
    )


def test_a_thrust_that_cannot_be_used_leaves_the_rotation(log: FlightLog) -> None:
    with_thrust = replace(log, signals=log.signals | {"thrust": np.full(len(log.time), 16.0)})
    assert channels_of(with_thrust) == channels_of(log)
    assert lacking(with_thrust) == ("throttle", "battery")
    alone = replace(log, signals={"thrust": with_thrust.signals["thrust"]})
    with pytest.raises(UsageError, match="thrust needs throttle, battery"):
        channels_of(alone)


@pytest.mark.parametrize(
    ("content", "part"),
    [
        ("vehicle: {kpq1: 3}", "expected 'vehicle:' with a 'type:'"),
        ("", "expected 'vehicle:'"),
        ("vehicle: {type: pelican, kpq9: 3}", "kpq9: no such parameter"),
    ],
)
def test_a_wrong_vehicle_file(content: str, part: str, tmp_path: Path) -> None:
    path = tmp_path / "v.yaml"
    path.write_text(content)
    fleet = next(iter(load_scenario("hover_ideal").spec.fleets))
    with pytest.raises(UsageError) as error:
        load_scenario("hover_ideal", [f"fleets.{fleet}.vehicle={{file: {path}}}"])
    assert part in str(error.value)


def test_a_gap_ends_a_window(log: FlightLog) -> None:
    roll = log.signals["roll"].copy()
    roll[130:160] = np.nan
    piece = cut(replace(log, signals=log.signals | {"roll": roll}), 2.0, 0.0, 0.6)
    rows = piece.windows[piece.used]
    assert not set(range(130, 160)) & set(rows.tolist())
    assert len(rows) == len(set(rows.tolist())) == 900 - 30
