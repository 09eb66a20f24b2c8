"""The small form of the study of qrsim train, and what the full form must have found."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from evidence import learn as study
from evidence.__main__ import plain

REPORT = Path(__file__).parents[1] / "docs" / "evidence" / "learn.json"


@pytest.mark.long
def test_the_small_form_trains_and_flies() -> None:
    found = plain(study.run(full=False))["keep_spot_seed_0"]
    # Two cycles of 2048 decisions, each of 32 steps of 64 episodes.
    assert found["decisions"] == 4096
    # In two seconds nothing goes far.
    assert (found["near"], found["flown_to_the_end"]) == (1.0, 1.0)
    assert -10.0 < found["mean"] < 0.0


def test_the_full_form_found_what_the_page_says() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    baseline = found["keep_spot"]["baseline"]["mean"]
    kept = [found[f"keep_spot_seed_{seed}"] for seed in range(10)]
    assert all(each["flown_to_the_end"] == 1.0 for each in kept)
    assert [seed for seed in range(10) if kept[seed]["mean"] < baseline] == [0, 2]
    reached = [found[f"goto_waypoint_seed_{seed}"] for seed in range(10)]
    assert all(each["near"] == each["flown_to_the_end"] == 1.0 for each in reached)
    assert all(each["mean"] < found["goto_waypoint"]["baseline"]["mean"] for each in reached)


def test_velocities_and_landings_are_learned_better_than_the_baselines_fly() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    kept = [found[f"keep_velocity_seed_{seed}"] for seed in range(10)]
    assert all(each["flown_to_the_end"] == 1.0 for each in kept)
    assert all(each["mean"] > found["keep_velocity"]["baseline"]["mean"] for each in kept)
    landed = [found[f"land_on_pad_seed_{seed}"] for seed in range(10)]
    assert all(each["near"] >= 0.995 and each["flown_to_the_end"] == 1.0 for each in landed)
    assert all(each["mean"] > found["land_on_pad"]["baseline"]["mean"] for each in landed)


def test_rates_and_motors_are_learned_as_well_as_the_baseline_flies() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    for actions in ("rates", "motors"):
        learned = [found[f"{actions}_seed_{seed}"] for seed in range(3)]
        assert all(each["flown_to_the_end"] == each["near"] == 1.0 for each in learned)
        assert all(each["mean"] > found[actions]["baseline"]["low"] for each in learned)
        assert found[actions]["hover"]["flown_to_the_end"] < 0.3


def test_cats_come_nearer_than_the_baseline_and_seldom_collide() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    baseline = found["cats_and_mouse_1A"]["baseline"]
    cats = [found[f"cats_and_mouse_1A_seed_{seed}"] for seed in range(10)]
    assert all(each["mean"] > baseline["mean"] and each["median"] > baseline["median"] + 5.0 for each in cats)
    assert all(each["flown_to_the_end"] >= 0.99 for each in cats)


def test_mice_escape_longer_than_the_baseline() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    baseline, mice = found["mouse"]["baseline"], [found[f"mouse_seed_{seed}"] for seed in range(10)]
    assert all(each["mean"] > baseline["mean"] for each in mice)
    assert all(each["flown_to_the_end"] > baseline["flown_to_the_end"] for each in mice)
    assert [seed for seed in range(10) if mice[seed]["median"] > baseline["median"]] == [1]


def test_formations_are_kept_by_three_of_ten_as_well_as_by_the_baseline() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    kept, baseline = [found[f"keep_formation_seed_{seed}"] for seed in range(10)], found["keep_formation"]["baseline"]
    assert all(each["flown_to_the_end"] == 1.0 and each["near"] >= 0.99 for each in kept)
    assert [seed for seed in range(10) if kept[seed]["near"] < 0.995] == [8]
    assert sum(each["mean"] > baseline["mean"] for each in kept) == 3
    assert min(each["mean"] for each in kept) > 3.85 * baseline["mean"]


def test_a_small_search_is_learned_but_most_often_the_baselines_win() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    learned = [found[f"search_small_seed_{seed}"] for seed in range(10)]
    compared = found["search_small"]
    assert all(compared["hover"]["median"] + 1.0 < each["median"] for each in learned)
    assert [seed for seed in range(10) if learned[seed]["mean"] > compared["baseline"]["mean"]] == [6]
    assert [seed for seed in range(10) if learned[seed]["near"] > 0.75] == [6, 8]
    assert [seed for seed in range(10) if learned[seed]["flown_to_the_end"] < 1.0] == [1]
    assert compared["baseline"]["mean"] < compared["pictures"]["mean"]
