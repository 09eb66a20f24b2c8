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


def test_faults_that_differ_in_numbers_only_have_a_few_lines() -> None:
    faults = ["a.0: -1.5e-3 m", "b: x", "a.1: 2 m", "a.2: +3 m", "a.3: 4 m", "a.4: 5 s", "b: y"]
    assert str(ScenarioError("s", faults[:4])).splitlines()[1:] == [f"  {faults[i]}" for i in (0, 2, 3, 1)]
    lines = ["  a.0: -1.5e-3 m", "  a.1: 2 m", "  ... and 2 more like it", "  b: x", "  a.4: 5 s", "  b: y"]
    assert str(ScenarioError("s", faults)).splitlines() == ["s: 7 problems", *lines]
    assert ScenarioError("s", faults).problems == faults
    # 400 of a hundred kinds have two lines and a count each; of 300 lines the first 200 are printed.
    kinds = [f"{chr(0x4E00 + kind)}.{i}" for kind in range(100) for i in range(4)]
    *_, last = str(ScenarioError("s", kinds)).splitlines()
    assert last == "  ... and 134 more"


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
