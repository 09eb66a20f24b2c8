"""The small form of the study of transfer, and what the full form must have found."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from evidence import transfer as study
from evidence.__main__ import plain

REPORT = Path(__file__).parents[1] / "docs" / "evidence" / "transfer.json"


@pytest.mark.long
def test_a_policy_of_calm_air_does_not_survive_the_field() -> None:
    found = plain(study.run(full=False))["calm_seed_0"]
    assert (found["calm"]["flown_to_the_end"], found["field"]["flown_to_the_end"]) == (1.0, 0.0)


def test_the_full_form_found_what_the_page_says() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    for seed in range(found["seeds"]):
        calm, field = found[f"calm_seed_{seed}"], found[f"field_seed_{seed}"]
        assert calm["calm"]["flown_to_the_end"] == 1.0
        assert field["field"]["flown_to_the_end"] > calm["field"]["flown_to_the_end"] + 0.5
