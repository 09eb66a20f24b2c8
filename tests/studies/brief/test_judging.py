"""Verdicts by the runs: what is a go, marginal and a no-go at which look."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from qrsim.studies.brief.judging import Row, judge, overall, undecided
from qrsim.studies.brief.operation import CriteriaSpec
from qrsim.studies.brief.runs import Runs
from qrsim.studies.brief.studying import METRICS, Piece, pieces

LIMITS = CriteriaSpec(p_loss=0.05)


class Given(Runs):
    """Runs with numbers: of every metric what a good run has, unless it is given."""

    def __init__(self, runs: int, **given: Any):
        super().__init__([], ("scout",))
        good = dict.fromkeys(METRICS, 0.0)
        good |= {"charge_end": 0.6, "fence_horizontal_min_m": 20.0, "ceiling_min_m": 30.0, "ground_min_m": 15.0}
        good |= {"stopped_leg": np.nan, "stopped_vehicle": np.nan}
        good |= {"air_separation_min_m": np.nan, "obstacle_min_m": np.nan, "stopped_s": np.nan, "failsafe_s": np.nan}
        self._arrays = {name: np.full(runs, value) for name, value in good.items()}
        for name, value in given.items():
            self._arrays[name][: len(value)] = value

    def __len__(self) -> int:
        return len(self._arrays["stopped"])

    def __getitem__(self, metric: str) -> Any:
        return self._arrays[metric]

    @property
    def seeds(self) -> Any:
        return np.arange(len(self))


def rows(runs: Runs, look: int | None, criteria: CriteriaSpec = LIMITS) -> dict[str, Row]:
    return {row.name: row for row in judge(runs, criteria, look)}


def verdicts(runs: Runs, look: int | None, criteria: CriteriaSpec = LIMITS) -> dict[str, str]:
    return {name: row.verdict for name, row in rows(runs, look, criteria).items()}


def test_the_pieces_of_the_nominal_stage() -> None:
    found = pieces(0.05)
    # 32 runs for an early no-go; the totals at the looks are 72, 144 and 288.
    assert [next(found) for _ in range(4)] == [Piece(0, 0, 32), Piece(1, 32, 40), Piece(2, 72, 72), Piece(3, 144, 144)]
    # A loose limit on losses does not loosen that on missions that do not finish.
    assert next(pieces(0.4)) == Piece(0, 0, 32)


def test_the_starts_of_a_window_share_the_runs_between_two_looks() -> None:
    found = Piece(1, 32, 40).parts(4)
    assert [(part.name, part.first, part.runs) for part in found] == [
        ("nominal_1_0", 32, 10), ("nominal_1_1", 42, 10), ("nominal_1_2", 52, 10), ("nominal_1_3", 62, 10)
    ]  # fmt: skip
    # A batch for each of two workers.
    assert found[0].batch == 5
    assert Piece(1, 32, 40).parts(1) == [Piece(1, 32, 40)]
    assert Piece(1, 32, 40).name == "nominal_1"


def test_72_runs_without_a_loss_are_a_go() -> None:
    found = verdicts(Given(72), 1)
    assert found == {"loss": "go", "finished": "go", "reserve": "go", "fence": "go", "ground": "go"}
    assert overall(judge(Given(72), LIMITS, 1)) == ("go", "every criterion is met")
    assert not undecided(judge(Given(72), LIMITS, 1))


def test_one_loss_needs_another_look() -> None:
    lost = {"stopped": [1.0], "stopped_s": [12.0], "left_area": [1.0], "stopped_leg": [2.0], "stopped_vehicle": [0.0]}
    lost["wind_max_m_s"] = [19.0]
    assert verdicts(Given(72, **lost), 1)["loss"] == "marginal"
    assert undecided(judge(Given(72, **lost), LIMITS, 1))
    assert verdicts(Given(144, **lost), 2)["loss"] == "go"
    loss = rows(Given(144, **lost), 2)["loss"]
    assert loss.why.startswith(
        "1 of 144 runs lost (0.69 %, could be up to 4.7 %): 1 left the area, the strongest wind of those that left was "
        "19 m/s; the place: vehicle scout, leg 2, 12 s, seed 0"
    )
    assert loss.worst is not None
    assert loss.worst.text() == "vehicle scout, leg 2, 12 s, seed 0"


def test_between_two_looks_nothing_that_needs_runs_is_decided() -> None:
    found = verdicts(Given(100), None)
    assert (found["loss"], found["finished"], found["reserve"]) == ("marginal", "marginal", "marginal")
    assert found["fence"] == "go"


def test_the_early_look_decides_against_only() -> None:
    assert verdicts(Given(32), 0)["loss"] == "marginal"
    found = rows(
        Given(
            32,
            stopped=[1.0] * 6,
            stopped_s=[30.0, 20.0, 25.0, 30.0, 30.0, 30.0],
            crashed=[1.0] * 6,
            charge_end=[0.0] * 4,
        ),
        0,
    )
    assert found["loss"].verdict == "no-go"
    assert (
        found["loss"].why == "6 of 32 runs lost (19 %, could be up to 34 %): 6 crashed, the battery was empty in 4; "
        "the earliest: 20 s, seed 1"
    )
    assert not undecided(list(found.values()))
    legs = {"stopped": [1.0] * 6, "stopped_s": [20.0] * 6, "stopped_leg": [4.0, 4.0, 1.0, 4.0, 4.0, 2.0]}
    assert "; 4 of them on leg 4; the earliest: leg 4, 20 s, seed 0" in rows(Given(32, **legs), 0)["loss"].why


def test_runs_that_do_not_finish() -> None:
    taken = {"failsafes": [1.0] * 20, "failsafe_s": [50.0] * 20, "charge_end": [0.14] * 18}
    found = rows(Given(72, not_finished=[1.0] * 20, **taken), 1)
    assert found["finished"].verdict == "no-go"
    assert (
        found["finished"].why
        == "20 of 72 runs do not finish the mission (28 %, could be up to 40 %); a failsafe takes over in 20, with the "
        "battery low in 18"
    )
    found = rows(Given(72, not_finished=[1.0] * 20, stopped=[1.0] * 7, stopped_s=[9.0] * 7), 1)
    assert found["finished"].why.endswith("; 7 are lost; 13 are still on their way when the run ends")


@pytest.mark.parametrize(("charge", "verdict"), [(0.21, "go"), (0.15, "marginal"), (0.05, "no-go")])
def test_the_reserve_is_that_of_the_worst_runs(charge: float, verdict: str) -> None:
    assert verdicts(Given(72, charge_end=[charge] * 12), 1)["reserve"] == verdict


def test_every_number_of_a_run_that_ends_in_the_air_is_json() -> None:
    given = {"not_finished": [1.0], "charge_end": [0.1], "down_s": [np.nan], "finished_s": [np.nan]}
    found = rows(Given(72, **given), 1)
    assert found["reserve"].worst is not None
    assert found["reserve"].worst.at_s is None
    json.dumps([asdict(row) for row in found.values()], allow_nan=False)


def test_a_lost_run_says_nothing_of_the_reserve() -> None:
    found = Given(72, charge_end=[0.01], stopped=[1.0], stopped_s=[3.0])
    assert rows(found, 1)["reserve"].value == 0.6


def test_a_run_that_an_empty_battery_ended_has_nothing_in_reserve() -> None:
    found = rows(Given(72, charge_end=[0.0] * 72, stopped=[1.0] * 72, stopped_s=[90.0] * 72), 1)["reserve"]
    assert (found.verdict, found.value) == ("no-go", 0.0)
    assert found.why == "1 of 20 runs ends with no charge; the reserve is 20 %"


@pytest.mark.parametrize(("metres", "verdict"), [(6.0, "go"), (3.0, "marginal"), (1.0, "no-go"), (-1.0, "no-go")])
def test_a_margin_names_its_moment(metres: float, verdict: str) -> None:
    margin = "fence_horizontal_min"
    given = {f"{margin}_m": [20.0, metres], f"{margin}_leg": [1.0, 3.0], f"{margin}_at_s": [5.0, 80.0]}
    row = rows(Given(72, **given), 1)["fence"]
    assert row.verdict == verdict
    nearest = {-1.0: "1.0 m beyond", 1.0: "1.0 m from", 3.0: "3.0 m from", 6.0: "6.0 m from"}[metres]
    assert row.why == (
        f"{'none of 72 runs comes' if metres > 5.0 else '1 of 72 runs comes'} nearer than 5 m to the sides of the area "
        f"or the ceiling; the nearest is {nearest} the sides of the area (vehicle scout, leg 3, 80 s, seed 1)"
    )


def test_the_worst_counts_and_what_is_only_reported_does_not() -> None:
    good = Row("loss", "go", 0.0, 0.0, 0.01, "1", "fine")
    bad = Row("fence", "no-go", 0.0, 0.0, 5.0, "m", "near")
    reported = Row("fault motor", "no-go", 0.0, None, 0.95, "1", "falls", None, False)
    assert overall([good, reported]) == ("go", "every criterion is met")
    assert overall([good, bad, reported]) == ("no-go", "near")
    worse = Row("loss", "no-go", 1.0, 1.0, 0.01, "1", "all are lost")
    assert overall([worse, bad]) == ("no-go", "all are lost; also no-go: distance to the area's limits")
    assert overall([]) == ("marginal", "nothing was flown")
