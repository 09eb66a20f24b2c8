"""What the parser of the command line refuses is told in one line, without boxes and without Python's words."""

from __future__ import annotations

import pytest

from qrsim.apps.complaints import sentence
from qrsim.cli import main


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("run hover --seed x", "qrsim run: --seed 'x': expected a whole number (see 'qrsim run --help')"),
        ("run hover --seed 1.5", "qrsim run: --seed '1.5': expected a whole number"),
        ("check hover --seeds ten", "qrsim check: --seeds 'ten': expected a whole number"),
        ("run hover --sed 1", "qrsim run: no such option '--sed'; did you mean '--seed'?"),
        ("run hover --seed", "qrsim run: --seed: its value is missing"),
        ("run hover extra", "qrsim run: 'extra' is one word too many"),
        ("run hover --precision float16", "--precision float16: expected float32, float64; did you mean 'float64'?"),
        (
            "run hover --duration 2x",
            "qrsim run: --duration: '2x' is no time; expected seconds, or a number with a unit",
        ),
        ("check", "qrsim check: SCENARIO is missing: Name (see 'qrsim list') or YAML file"),
        ("compare a", "qrsim compare: RUN_B is missing: Run folder to compare with"),
        ("openloop a.csv b.csv", "qrsim openloop: --units {raw,si} is missing: Units of the commands"),
        ("autopilot", "qrsim autopilot: expected a command: betaflight, ardupilot"),
        ("autopilot betaflight --scenari x", "qrsim autopilot betaflight: no such option '--scenari'"),
        ("autopilot betaflght", "qrsim autopilot: no such command 'betaflght'; did you mean 'betaflight'?"),
        ("ros2 hover --api mavrso", "--api mavrso: expected qrsim, mavros, px4; did you mean 'mavros'?"),
        ("mavlink hover --local-origin sight", "--local-origin sight: expected start or site; did you mean 'site'?"),
        ("", "qrsim: expected a command: run, check"),
        ("--hepl", "qrsim: no such option '--hepl'; did you mean '--help'?"),
    ],
)
def test_a_wrong_argument(
    arguments: str, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # Narrow, so that the parser breaks its lines.
    monkeypatch.setenv("COLUMNS", "30")
    assert main(arguments.split()) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert words in line


def test_help_is_still_laid_out(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--help"]) == 0
    said = capsys.readouterr()
    assert "Fly a scenario, record it" in said.out
    assert said.err == ""


def test_a_box_that_nobody_knows_is_told_as_it_is() -> None:
    assert sentence("Oh\n--\n It is \n broken \n -----\n help\n", ()) == "It is broken"
    assert sentence("╭─ Oh ──╮\n│ It is  │\n│ broken │\n│ ────── │\n│ help   │\n╰────────╯\n", ()) == "It is broken"
