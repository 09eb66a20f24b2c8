"""The small form of the study of transfer, and what the full form must have found."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from evidence import transfer as study
from evidence.__main__ import plain

REPORT = Path(__file__).parents[1] / "docs" / "evidence" / "transfer.json"


@pytest.mark.long
def test_the_small_form_trains_in_calm_air_and_flies_in_both_places() -> None:
    found = plain(study.run(full=False))["calm_seed_0"]
    assert found["calm"]["flown_to_the_end"] == 1.0
    assert found["field"]["mean"] < found["calm"]["mean"]


def test_the_full_form_found_what_the_page_says() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    assert found["seeds"] == 3
    for seed in range(3):
        calm, field = found[f"calm_seed_{seed}"], found[f"field_seed_{seed}"]
        assert all(each["flown_to_the_end"] == 1.0 for policy in (calm, field) for each in policy.values())
        # Policies of calm air are better in both places.
        assert all(calm[place]["mean"] > field[place]["mean"] for place in ("calm", "field"))
