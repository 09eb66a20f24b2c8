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
    found = plain(study.run(full=False))["calm_plain_seed_0"]
    assert found["calm"]["flown_to_the_end"] == 1.0
    assert found["field"]["mean"] < found["calm"]["mean"]


def test_the_full_form_found_what_the_page_says() -> None:
    found = json.loads(REPORT.read_text("utf-8"))["results"]
    assert found["seeds"] == 3
    policies = {
        name: [found[f"{name}_seed_{seed}"] for seed in range(3)]
        for name in ("calm_plain", "field_plain", "calm_integral", "field_integral")
    }
    assert all(
        place["flown_to_the_end"] == 1.0 for each in policies.values() for seed in each for place in seed.values()
    )

    def field(name: str) -> list[float]:
        return [seed["field"]["mean"] for seed in policies[name]]

    # Without memory, policies of calm air are better in the field too; with the integral those of the field are.
    assert min(field("calm_plain")) > max(field("field_plain"))
    assert min(field("field_integral")) > max(field("calm_integral"))
    assert sum(field("field_integral")) > sum(field("calm_plain"))
    assert sum(each < max(field("calm_plain")) for each in field("field_integral")) == 2
