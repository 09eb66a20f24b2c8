"""The small form of the study of formations in gusts (``make evidence formation_gusts``), and its estimators."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from evidence import _formation_pictures as pictures
from evidence import _intervals as interval
from evidence import formation_gusts as study

from qrsim.scenarios.scenario import load_scenario


def test_intervals_are_those_of_the_textbook() -> None:
    """Bootstrap of a mean beside s/sqrt(n), and the exact ones of 0 and 10 of 40 (Clopper and Pearson 1934)."""
    values = np.random.default_rng(3).standard_normal(400)
    found = interval.mean(values)
    error = values.std() / 20.0
    assert found["value"] == pytest.approx(values.mean())
    assert found["high"] - found["low"] == pytest.approx(2.0 * 1.96 * error, rel=0.08)
    none = interval.share(np.zeros(40, bool))
    # 1 - 0.025^(1/40)
    assert (none["value"], none["low"], none["high"]) == (0.0, 0.0, pytest.approx(0.0881, abs=1e-4))
    some = interval.share(np.arange(40) < 10)
    assert (some["low"], some["high"]) == (pytest.approx(0.1269, abs=1e-4), pytest.approx(0.4120, abs=1e-4))


def test_neighbours_of_a_grid_and_what_correlates_them() -> None:
    """Gusts that are one along the way, opposite across one way and unrelated across the other, and vertically."""
    numbers = np.random.default_rng(1)
    gust = np.empty((3, 50, 5, 4, 3))
    # Of each column its own to the north; of each row its sign to the east.
    gust[..., 0] = numbers.standard_normal((3, 50, 1, 4))
    gust[..., 1] = numbers.standard_normal((3, 50, 1, 1)) * (-1.0) ** np.arange(5)[:, None]
    gust[..., 2] = numbers.standard_normal((3, 50, 5, 4))
    flat = gust.reshape(3, 50, 20, 3)
    (north_pairs, east_pairs) = study.neighbours(flat)
    assert (north_pairs[0].shape, east_pairs[0].shape) == ((3, 50, 16, 3), (3, 50, 15, 3))
    found = study.correlations(flat)
    assert found["along"]["value"] == pytest.approx(1.0)
    # To the north -1, to the east 0.
    assert found["across"]["value"] == pytest.approx(-0.5, abs=0.1)
    assert abs(found["vertical"]["value"]) < 0.1


def test_a_lag_is_found_between_steps() -> None:
    """A sine that arrives 2.01 s later at each vehicle, sampled at every 0.2 s."""
    time, delay = np.arange(0.0, 60.0, 0.2), study.APART / study.CARRIED
    gust = np.zeros((4, len(time), 5, 3))
    for world in range(4):
        for i in range(5):
            gust[world, :, i, 0] = np.sin(2.0 * math.pi * (time - i * delay) / 17.0 + world)
    found = study.lags(study.Flown(np.zeros_like(gust), gust, 0.2), 0.0)
    # u20 ln(20 m/z0)/ln(20 ft/z0) = 4 x 1.2430 m/s.
    assert found["expected_s"] == pytest.approx(10.0 / 4.972, rel=1e-3)
    assert found["lag_s"]["value"] == pytest.approx(found["expected_s"], abs=0.03)


@pytest.mark.parametrize("over_ground", study.FLIGHTS.values())
def test_lines_fly_within_their_area_for_as_long_as_the_study_lasts(over_ground: float) -> None:
    """The corners of a route are checked where a scenario is read."""
    content = study.line("dryden_field", over_ground, study.LEFT_OUT_S + study.FULL[1])
    assert load_scenario(content, quiet=True).world().fleets[0].size == study.ABREAST


def test_the_animation_is_small() -> None:
    assert 50_000 < pictures.GUST.stat().st_size < 1_000_000


@pytest.mark.long
def test_spacings_are_drawn(tmp_path: Path) -> None:
    row = {"value": 0.5, "low": 0.4, "high": 0.6}
    kind = {"correlation": {"horizontal": row, "vertical": row}, "relative_std": {"north": row, "down": row}}
    pictures.draw_spacings(
        {name: {"dryden": kind, "dryden_field": kind} for name in ("1", "7")}, study.closed, tmp_path / "a.png"
    )
    assert 10_000 < (tmp_path / "a.png").stat().st_size < 200_000


@pytest.mark.nightly
def test_one_air_keeps_formations_together_and_carries_gusts_along() -> None:
    """8 seeds of 40 s: more common motion, a quarter of the relative motion, and gusts that arrive when they must."""
    found = study.run(full=False)
    near = found["grid"]["3"]
    for name in ("along", "across", "vertical"):
        assert near["dryden_field"]["correlation"][name]["value"] == pytest.approx(near["closed"][name], abs=0.05)
        assert abs(near["dryden"]["correlation"][name]["value"]) < 0.1
    for axis, factor in (("north", 4.0), ("east", 4.0), ("down", 2.0)):
        both = [near[kind]["relative_std"][axis]["value"] for kind in study.KINDS]
        assert both[0] > factor * both[1]
        # One air: the 40 seeds of 160 s of the full study have a standard error of 5.5 %, so that these have 24 %.
        assert near["dryden"]["own_std"][axis]["value"] == pytest.approx(
            near["dryden_field"]["own_std"][axis]["value"], rel=0.5
        )
        centre = [near[kind]["centre_std"][axis]["value"] for kind in study.KINDS]
        assert centre[1] > 2.0 * centre[0]
    assert near["dryden"]["nearer"]["value"] > 0.3
    assert near["dryden_field"]["nearer"]["value"] == 0.0
    # 50 m apart vertical gusts are as good as unrelated.
    far = found["grid"]["50"]["dryden_field"]
    assert abs(far["correlation"]["vertical"]["value"]) < 0.08
    assert far["relative_std"]["down"]["value"] > 0.8 * near["dryden"]["relative_std"]["down"]["value"]
    for flight in found["line"].values():
        met = flight["dryden_field"]
        assert met["lag_s"]["value"] == pytest.approx(met["expected_s"], abs=0.1)
        assert met["then"]["value"] > 0.97
        assert met["at_once"]["value"] < met["then"]["value"] - 0.03
        assert abs(flight["dryden"]["then"]["value"]) < 0.15
    assert found["line"]["downwind"]["dryden"]["speed"] == pytest.approx(8.0, abs=0.05)
    for row in found["sweep"].values():
        assert row["line"]["then"]["value"] == pytest.approx(row["then_closed"], abs=0.06)
