"""Mutation testing by Cosmic Ray: the tests that a module gets, and a sample every night."""

from __future__ import annotations

import random
import re
import tomllib

import pytest
from tests.mutation import FOLDERS, ROOT, main, modules, selection, tried

# Modules drawn, and mutants of each; a mutant in four may survive, as bounds and others do that change no result.
SEED, MODULES, EACH, LEAST = 20261126, 3, 3, 0.75


def test_a_module_is_tested_by_its_own_tests_then_by_its_users_and_then_by_its_folder() -> None:
    folder = "tests/models/sensors"
    found = selection("models/sensors/barometer.py")
    assert found[0] == f"{folder}/test_barometer.py"
    assert f"{folder}/test_faults.py" in found[1:-1]
    assert found[-1] == folder


def test_paths_are_files_and_folders() -> None:
    assert modules(["models/sensors/barometer.py"]) == ["models/sensors/barometer.py"]
    found = modules(FOLDERS)
    assert {"control/ekf.py", "models/atmosphere/gust.py"} <= set(found)
    assert not [module for module in found if not (ROOT / "tests" / module).parent.is_dir()]


def test_a_path_without_modules_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["models/sensor"])
    assert (
        "no module at src/qrsim/models/sensor; give one such as models/sensors/barometer.py" in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("operator", "left_out"),
    [
        ("NumberReplacer", False),
        ("ReplaceBinaryOperator_Add_Sub", False),
        ("ReplaceUnaryOperator_Delete_USub", False),
        ("ReplaceComparisonOperator_Lt_LtE", False),
        ("ReplaceComparisonOperator_Is_IsNot", False),
        ("ReplaceBinaryOperator_BitOr_Add", True),
        ("ReplaceBinaryOperator_Mul_Pow", True),
        ("ReplaceComparisonOperator_Eq_Is", True),
        ("ReplaceUnaryOperator_USub_Not", True),
        ("RemoveDecorator", True),
    ],
)
def test_operators(operator: str, left_out: bool) -> None:
    settings = tomllib.loads((ROOT / "cosmic-ray.toml").read_text("utf-8"))["cosmic-ray"]
    patterns = settings["filters"]["operators-filter"]["exclude-operators"]
    assert any(re.match(pattern, f"core/{operator}") for pattern in patterns) == left_out


@pytest.mark.nightly
def test_a_sample() -> None:
    choose, found = random.Random(SEED), []
    for module in choose.sample(modules(FOLDERS), MODULES):
        found += tried(module, EACH, SEED)
    survivors = [mutant.diff for mutant in found if mutant.outcome != "killed"]
    assert len(survivors) <= (1.0 - LEAST) * len(found), "\n".join(survivors)
