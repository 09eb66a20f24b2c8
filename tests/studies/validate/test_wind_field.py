"""The part of the validation about the field of gusts."""

from __future__ import annotations

import math
from typing import Any

import pytest

from qrsim.studies.validate import wind_field as part


@pytest.fixture(scope="module")
def points() -> dict[str, dict[str, tuple[float, float]]]:
    """Correlations at two points of 100 worlds."""
    return part.two_points(part.FEW_WORLDS)


def failed(points: Any, frozen: Any, carried: Any) -> list[str]:
    """Return the checks that fail."""
    return [check.name for check in part._field_checks(points, frozen, carried, part.FEW_WORLDS) if not check.passed]


def test_closed_forms_are_those_of_the_standard_s_lengths() -> None:
    """15 m are 49.2 ft: L_u = 93.6 m, L_w = 15 m; g is zero at 2 L."""
    assert part.closed(10.0)["along"] == pytest.approx(math.exp(-10.0 / 93.57), rel=1e-3)
    assert part.closed(10.0)["across"] == pytest.approx((1.0 - 5.0 / 93.57) * math.exp(-10.0 / 93.57), rel=1e-3)
    assert part.closed(30.0)["vertical"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.long
def test_the_field_passes(points: Any) -> None:
    """Every correlation, and the travel of gusts in a frozen field and of waves with a lifetime."""
    assert failed(points, part.travelling(4), part.travelling(part.FEW_WORLDS, "lifetime")) == []


@pytest.mark.long
@pytest.mark.parametrize("changed", ["length", "sigma"])
def test_a_field_of_another_length_or_size_fails(points: Any, monkeypatch: pytest.MonkeyPatch, changed: str) -> None:
    """Beside lengths or standard deviations that are a fifth smaller."""
    own = part.dryden_scales

    def smaller(height: float, speed: float) -> Any:
        lengths, sigmas = own(height, speed)
        return (lengths / 1.2, sigmas) if changed == "length" else (lengths, sigmas / 1.2)

    monkeypatch.setattr(part, "dryden_scales", smaller)
    other = points
    if changed == "sigma":
        # Only the variance is in units of the standard's.
        other = {**points, "0": {name: (value * 1.44, error * 1.44) for name, (value, error) in points["0"].items()}}
    assert len(failed(other, {}, {})) >= 2


@pytest.mark.long
def test_gusts_that_do_not_travel_fail(points: Any) -> None:
    """A correlation of 0.99 with what was upwind a second before; of 0.90, or 1, after 20 s of 100 (0.767)."""
    assert len(failed(points, {"1": (0.99, 0.01)}, {})) == 1
    assert len(failed(points, {}, {"20": (0.90, 0.01)})) == 1
    assert len(failed(points, {}, {"20": (1.0, 0.01)})) == 1
