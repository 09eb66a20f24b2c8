"""What ``qrsim check`` says of estimators: means over runs, their intervals, and the table."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from qrsim.apps.check.consistency import ROWS, Row, consistency, print_consistency

NAN = float("nan")


def flown(**metrics: list[list[float]]) -> Any:
    """Return what a rollout of three runs with two vehicles gives; NaN where nothing is stated."""
    return cast("Any", {name: np.array(metrics.get(name, [[NAN, NAN]] * 3)) for name in ROWS.values()})


def test_a_run_counts_once_with_the_mean_of_its_vehicles() -> None:
    """Means 1, 2 and 3: 2 with s = 1, and t(0.975; 2) = 4.303 gives 4.303/sqrt(3) = 2.484 to both sides."""
    [row] = consistency(flown(anees_position=[[0.5, 1.5], [2.0, NAN], [3.0, 3.0]]))
    assert (row.name, row.mean, row.runs) == ("position", 2.0, 3)
    assert (row.low, row.high) == pytest.approx((-0.484, 4.484), abs=1e-3)
    assert row.verdict == "consistent"


def test_a_run_in_which_nobody_states_anything_does_not_count() -> None:
    """Means 1 and 3: 2 with s = sqrt(2), and t(0.975; 1) = 12.706 to both sides."""
    [row] = consistency(flown(anees=[[1.0, 1.0], [NAN, NAN], [3.0, 3.0]]))
    assert (row.name, row.mean, row.runs) == ("all errors", 2.0, 2)
    assert row.high == pytest.approx(14.706, abs=1e-3)
    assert consistency(flown()) == []


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (1.01, 1.4, "errors exceed the reported ones"),
        (0.6, 0.99, "errors are below the reported ones"),
        (1.0, 1.2, "consistent"),
        (NAN, NAN, ""),
    ],
)
def test_verdicts(low: float, high: float, verdict: str) -> None:
    assert Row("bias", 1.0, low, high, 5).verdict == verdict


def test_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    print_consistency([Row("velocity", 1.234, 1.1, 1.368, 9), Row("bias", 0.5, NAN, NAN, 1)])
    head, velocity, bias = capsys.readouterr().out.splitlines()[1:]
    assert head == "squared errors of the estimate divided by its reported covariance (ANEES; 1 if consistent)"
    assert velocity.split(maxsplit=2) == [
        "velocity",
        "1.23",
        "95 % interval 1.10 to 1.37, errors exceed the reported ones",
    ]
    # One run has no interval.
    assert bias.split() == ["bias", "0.50"]
    print_consistency([Row("position", 27.0, NAN, NAN, 1)])
    *_, means, where = capsys.readouterr().out.splitlines()
    assert means.startswith("  Above 1 the errors exceed the reported ones: GNSS errors last for minutes")
    assert where.endswith("(docs/explanation/consistency.md).")
    # Slow errors of fixes are the reason of those of the position alone, and an interval with 1 in it shows nothing.
    print_consistency([Row("position", 0.9, 0.8, 1.02, 9), Row("bias", 3.52, 3.27, 3.76, 9)])
    *_, last = capsys.readouterr().out.splitlines()
    assert last == "  Above 1 the errors are larger than the estimator reports (docs/explanation/consistency.md)."
    print_consistency([Row("all errors", 2.19, -2.07, 6.45, 3)])
    *_, last = capsys.readouterr().out.splitlines()
    assert last.split(maxsplit=3)[3] == "95 % interval 0.00 to 6.45, consistent"
    print_consistency([])
    assert capsys.readouterr().out == ""


def test_what_is_not_known_is_none_as_json() -> None:
    known = {"name": "attitude", "mean": 0.9, "low": None, "high": None, "runs": 1}
    assert Row("attitude", 0.9, NAN, NAN, 1).to_json() == known
