"""Messages of errors and warnings: one line for each fault, whatever names and values the input has in it."""

from __future__ import annotations

import json
import pickle
import re
from pathlib import Path

import pytest

from qrsim.cli import main
from qrsim.errors import LogError, RunError, ScenarioError, UsageError, warn_user

NASTY = "a\nb\r\x1b[31m\u2028c"
SHOWN = r"a\nb\r\x1b[31m\u2028c"


def test_a_line_of_an_error_is_one_line() -> None:
    assert str(UsageError(f"no '{NASTY}'")) == f"no '{SHOWN}'"
    many = RunError("head", f"  {NASTY}", "  tab\tstays")
    assert str(many).splitlines() == ["head", f"  {SHOWN}", "  tab\tstays"]
    assert f"{many}" == f"head; {SHOWN}; tab\tstays"
    faults = ScenarioError(NASTY, [f"x: {NASTY}", "y"])
    assert str(faults).splitlines() == [f"{SHOWN}: 2 problems", f"  x: {SHOWN}", "  y"]
    assert faults.problems == [f"x: {SHOWN}", "y"]
    log = LogError(NASTY, [NASTY])
    assert (str(log), log.details) == (SHOWN, [SHOWN])
    for error in (many, faults, log):
        again = pickle.loads(pickle.dumps(error))
        assert (str(again), vars(again)) == (str(error), vars(error))


def test_a_warning_is_one_line() -> None:
    with pytest.warns(UserWarning, match=f"^{re.escape(SHOWN)}$"):
        warn_user(NASTY)


def test_names_in_files_do_not_break_messages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = tmp_path / "x.yaml"
    fleet = {NASTY: 1, "controller": {"type": NASTY}, "vehicles": [{"position_ned": [0, 0, -5]}]}
    scenario.write_text(json.dumps({"name": "x", "fleets": {"a": fleet}}))
    table = tmp_path / "log.csv"
    table.write_text(f'"{NASTY}","x"\n1,2\n', newline="")
    expected = {
        ("show", str(scenario)): 3,
        ("run", NASTY): 1,
        ("plot", NASTY): 1,
        ("view", NASTY): 1,
        ("identify", str(table)): 1,
        ("run", "hover_ideal", "--set", f"{NASTY}=1"): 2,
    }
    for arguments, lines in expected.items():
        assert main(list(arguments)) in (1, 2)
        said = capsys.readouterr().err
        assert said.startswith("error: ")
        assert r"a\nb" in said
        assert len(said.splitlines()) == lines, said
