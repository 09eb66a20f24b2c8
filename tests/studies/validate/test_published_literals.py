"""Validation knows what models should say, and does not ask them: a model with another constant fails its checks."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.core.tree import replace
from qrsim.models.atmosphere import dryden
from qrsim.models.gnss.errors import GaussMarkov2
from qrsim.models.sensors.attitude import AttitudeEstimator
from qrsim.models.sensors.barometer import Barometer
from qrsim.studies.validate import drifts, gnss, published, spectra
from qrsim.studies.validate.statistics import widest_z

# Hours of flight for hundreds of vehicles: what XLA optimises for seconds runs in a tenth of the time.
pytestmark = pytest.mark.usefixtures("optimised")
MORE = 1.2


def test_published_numbers_follow_from_their_sources() -> None:
    """Steps of the reference, by the variance of a first-order process; the standard's own numbers at 20 ft."""
    assert published.BAROMETER.std == pytest.approx(0.003 / math.sqrt(1.0 - math.exp(-0.04 / 300.0)), rel=2e-3)
    assert published.ATTITUDE.std == pytest.approx(0.0005 * math.sqrt(100.0 / 2.0), rel=2e-3)
    assert published.RANGE_ERRORS["ou"].std == pytest.approx(
        0.1746 / math.sqrt(1.0 - math.exp(-0.4 / 2000.0)), rel=1e-3
    )
    assert published.RANGE_ERRORS["gauss_markov_2"].slow == pytest.approx(0.2 / math.log(1.005), rel=1e-3)
    # L_u = 20/(0.177 + 0.01646)^1.2 = 143.4 ft, sigma_u = 0.1 u20/0.19346^0.4 = 0.1929 u20.
    lengths, sigmas = published.dryden_scales(20.0 * 0.3048, 1.0)
    assert lengths / 0.3048 == pytest.approx([143.54, 143.54, 20.0], rel=1e-3)
    assert sigmas == pytest.approx([0.19293, 0.19293, 0.1], rel=1e-3)
    lengths, sigmas = published.dryden_scales(2500.0 * 0.3048, 1.0)
    assert lengths / 0.3048 == pytest.approx([1750.0] * 3)
    assert sigmas / 0.3048 == pytest.approx([7.0875] * 3)
    assert published.wind_over_20ft(50.0 * 0.3048) == pytest.approx(1.1873, rel=1e-4)


def test_the_driven_process_is_the_recursion_of_the_reference() -> None:
    """y' = y exp(-T/4) + 0.003 n, x' = x/1.005 + y: the variance of x, and its autocovariance after 20 s."""
    step, gain = math.exp(-0.2 / 4.0), 1.0 / 1.005
    transition = np.array([[gain, 1.0], [0.0, step]])
    covariance = np.zeros((2, 2))
    for _ in range(20_000):
        covariance = transition @ covariance @ transition.T + np.diag([0.0, 0.003**2])
    of = published.RANGE_ERRORS["gauss_markov_2"]
    later = np.linalg.matrix_power(transition, 100) @ covariance
    # In the reference the drive acts a step later, and as a sum: 2 % of the variance.
    assert math.sqrt(covariance[0, 0]) == pytest.approx(of.std, rel=0.02)
    assert later[0, 0] / covariance[0, 0] == pytest.approx(of.autocovariance(np.array([20.0]))[0] / of.std**2, rel=0.01)


@pytest.mark.parametrize(
    ("sensor", "change"),
    [
        ("barometer", {"drift_std": 0.26 * MORE}),
        ("barometer", {"drift_time_constant": 300.0 * MORE}),
        ("attitude", {"std": 0.00354 * MORE}),
        ("attitude", {"time_constant": 100.0 * MORE}),
        ("barometer", {}),
        ("attitude", {}),
    ],
)
def test_a_drift_of_another_size_or_speed_fails(sensor: str, change: dict[str, float]) -> None:
    """20 % more of either; as it is, all pass."""
    models: dict[str, Any] = {"barometer": Barometer(), "attitude": AttitudeEstimator()}
    stated = {"barometer": published.BAROMETER, "attitude": published.ATTITUDE}[sensor]
    # As many as the quick form has would not tell; these take a second.
    found = drifts.read(sensor, replace(models[sensor], **change), "x", *stated, "u", 1024)
    passed = [check.passed for check in drifts._drift_checks(sensor, found)]
    assert all(passed) == (not change)


@pytest.mark.long
@pytest.mark.parametrize(
    "change", [{"std": 0.58878 * MORE}, {"time_constant": 40.1 * MORE}, {"drive_time_constant": 4.0 * MORE}, {}]
)
def test_range_errors_of_another_size_or_speed_fail(
    recordings: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, float]
) -> None:
    """20 % more of each number of the paper's model."""
    errors = replace(GaussMarkov2(), **change)
    monkeypatch.setattr(gnss, "MODELS", {gnss.PAPER: (errors, "")})
    record = gnss.recorded_receiver(recordings / gnss.RECORDING)
    run, _ = gnss.simulate(gnss.PAPER, recordings / gnss.ORBITS, record, 200)
    assert all(check.passed for check in gnss._allan_checks({gnss.PAPER: run}, 200)) == (not change)


@pytest.mark.long
@pytest.mark.parametrize(
    "changed", [pytest.param("length", marks=pytest.mark.long), "sigma", pytest.param("", marks=pytest.mark.long)]
)
def test_gusts_of_another_size_or_length_fail(monkeypatch: pytest.MonkeyPatch, changed: str) -> None:
    """20 % more of the standard's lengths or standard deviations, flown at 15 m."""
    own: Callable[..., Any] = dryden.dryden_scales

    def other(*arguments: Any, **more: Any) -> Any:
        lengths, sigmas = own(*arguments, **more)
        return (lengths * MORE if changed == "length" else lengths, sigmas * MORE if changed == "sigma" else sigmas)

    monkeypatch.setattr(dryden, "dryden_scales", other)
    spectra._simulate_series.clear_cache()
    case = spectra.CASES["low"]
    results, _ = spectra.compare(
        spectra.our_series(case, 131_072, 3), lambda omega: spectra.sampled_closed_form(case, omega), case
    )
    spectra._simulate_series.clear_cache()
    z = widest_z(len(spectra.COMPONENTS))
    fine = all(abs(of["variance"]["z"]) <= z and of["rms_db_from_own_theory"] <= 0.8 for of in results.values())
    assert fine == (not changed)
