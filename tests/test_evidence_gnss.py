"""The small form of the study of GNSS receivers (``make evidence gnss``), and the recorded one in its band."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evidence import gnss as study


def test_a_day_of_four_systems() -> None:
    """28.5 satellites on average above 10 deg at 51.7 N; HDOP 0.50 and VDOP 0.76 in the median."""
    found = study.day("GERC")
    assert found["satellites_mean"] == pytest.approx(28.5, abs=1.0)
    assert found["hdop_50"] == pytest.approx(0.50, abs=0.02)
    assert found["vdop_50"] == pytest.approx(0.76, abs=0.04)


@pytest.mark.nightly
def test_the_small_form_is_of_the_right_size() -> None:
    """A dual-frequency receiver without corrections: below the data sheet's 1.5 m, and honest within a third."""
    found = study.run(False)
    accuracy = found["presets"]["f9p_single"]
    assert 0.3 < accuracy["cep_m"] < 1.5
    assert accuracy["horizontal_accuracy_m"] / accuracy["horizontal_rms_m"] == pytest.approx(1.0, abs=0.35)
    assert 0.6 < accuracy["heights_correlated"] < 0.95
    assert found["steps"]["f9p_single"]["else_max_m"] < 0.05
    assert found["steps"]["f9p_single"]["velocity_max_m_s"] < 0.5
    assert 6.0 < found["fixing"]["0"]["first_median_s"] < 12.0
    assert 0.008 < found["fixing"]["0"]["cep_m"] < 0.013
    assert found["fixing"]["0"]["cep_m"] < found["fixing"]["10"]["cep_m"] < found["fixing"]["30"]["cep_m"]


def test_jammers_reach_as_far_as_is_published() -> None:
    """10 mW end tracking from 45 dB-Hz within 0.6 to 0.9 km; with the root of the power."""
    rows = study.jamming()
    assert 600.0 < rows["10"]["lost_m"] < 900.0
    assert rows["1000"]["lost_m"] / rows["10"]["lost_m"] == pytest.approx(10.0, rel=0.03)
    assert rows["10"]["not_found_m"] / rows["10"]["lost_m"] == pytest.approx(2.55, rel=0.05)


@pytest.mark.nightly
def test_the_recorded_receiver_is_one_of_the_simulated(recordings: Path) -> None:
    """Every window to 20 s is in the 1 to 99 % band of 200 runs; the slope from 0.4 to 2 s is 0.8 to 1."""
    path = recordings / study.RECORDING
    recorded, simulated = study.recorded_deviation(path), study.simulated_deviations(200)
    low, high = np.quantile(simulated, study.BAND, axis=1)
    short = 0.4 * study.WINDOWS <= 20.0
    assert ((low <= recorded) & (recorded <= high))[short].all()
    slope = np.log(np.median(simulated, axis=1)[3] / np.median(simulated, axis=1)[0]) / np.log(5.0)
    assert np.all((slope > 0.8) & (slope < 1.0))
