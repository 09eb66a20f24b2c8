"""The small form of the study of the controllers (``make evidence control``)."""

from __future__ import annotations

import pytest
from evidence import control as study


@pytest.fixture(scope="module")
def steps() -> dict[str, dict[str, dict[str, float]]]:
    return study.step_responses()


@pytest.mark.long
def test_every_controller_settles_where_it_is_asked_to(steps: dict[str, dict[str, dict[str, float]]]) -> None:
    """In calm air, to 1 % of the step; heights to 5 %, because the published integral takes minutes."""
    for fleet, responses in steps.items():
        for quantity, found in responses.items():
            if quantity in ("roll", "pitch"):
                # The platform's own stabilisation settles at 0.74498 of a tilt command
                # (docs/explanation/models/control.md).
                assert found["error_percent"] == pytest.approx(25.502, abs=0.05), (fleet, quantity)
            else:
                assert abs(found["error_percent"]) < (5.0 if quantity == "height" else 1.0), (fleet, quantity)
                assert found["overshoot_percent"] < 10.0, (fleet, quantity)
                assert 0.1 < found["rise_s"] < 10.0, (fleet, quantity)


def test_nobody_falls_out_of_the_sky_in_wind() -> None:
    """Bounds far from what the full study finds, so that only a broken controller passes them."""
    found = study.errors_in_wind(*study.SMALL)
    assert found["stopped"] == 0
    for name, band in ((name, band) for name, band in found.items() if isinstance(band, dict)):
        assert 0.0 < band["low"] < band["mean"] < band["high"], name
        assert band["mean"] < (12.0 if "waypoint" in name else 4.0 if name.endswith("_m") else 0.6), name
