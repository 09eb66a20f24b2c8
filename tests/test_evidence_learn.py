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
    kept = [found[f"keep_spot_seed_{seed}"] for seed in range(10)]
    assert all(each["flown_to_the_end"] >= 0.99 for each in kept)
    assert all(each["mean"] > found["keep_spot"]["baseline"]["mean"] for each in kept)
    reached = [found[f"goto_waypoint_seed_{seed}"]["near"] for seed in range(10)]
    assert sorted(reached)[:2] == [0.39, 0.975]
    assert sorted(reached)[2:] == [1.0] * 8
    # No seed has learned to crash.
    assert all(found[f"goto_waypoint_seed_{seed}"]["flown_to_the_end"] == 1.0 for seed in range(10))


def test_velocities_and_landings_are_learned_better_than_the_baselines_fly() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    kept = [found[f"keep_velocity_seed_{seed}"] for seed in range(7)]
    assert all(each["flown_to_the_end"] == 1.0 for each in kept)
    assert all(each["mean"] > found["keep_velocity"]["baseline"]["mean"] for each in kept)
    landed = [found[f"land_on_pad_seed_{seed}"] for seed in range(5)]
    assert all(each["near"] >= 0.98 for each in landed)
    assert all(each["mean"] > found["land_on_pad"]["baseline"]["mean"] for each in landed)


def test_cats_come_nearer_than_the_baseline_but_collide() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    baseline = json.loads(REPORT.with_name("tasks.json").read_text("utf-8"))["results"]["cats_and_mouse_1A"]["baseline"]
    cats = [found[f"cats_and_mouse_1A_seed_{seed}"] for seed in range(3)]
    assert [each["median"] > baseline["median"] for each in cats] == [True, True, False]
    assert all(0.9 <= each["flown_to_the_end"] < 0.95 for each in cats)
