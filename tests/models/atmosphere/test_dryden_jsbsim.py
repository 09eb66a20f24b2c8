"""The full Dryden turbulence beside JSBSim's, in the short form of its study."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from evidence import turbulence as study

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("jsbsim") is None, reason=f"no JSBSim to compare with; {study.INSTALL}"
)


@pytest.mark.long
def test_variances_and_spectra_of_both() -> None:
    """Every variance is the one its own recursion has, at 99.9 % confidence over all; spectra are near the standard's.

    Over the 2600 s of this record a band's level has a standard error of up to 0.7 dB (one or two of Welch's bins,
    63 half-overlapping segments), the 23 bands together of 0.3 dB at most.
    """
    results = study.run(full=False)
    assert results["smallest_p"] > results["p_limit"]
    case = results["low"]
    for name in study.COMPONENTS:
        assert case["ours"][name]["expected_over_closed_form"] == pytest.approx(1.0, abs=1e-3)
        for source in ("ours", *study.TYPES):
            assert case[source][name]["rms_db_from_own_theory"] < 0.8
    # What the bilinear transform costs, and what the first-order form of type 3 does, are small beside the spectra.
    for source in ("ours", *study.TYPES):
        for name in ("u", "v", "w"):
            assert case[source][name]["largest_db_from_closed_form"] < 3.0


def test_recursions_of_jsbsim_are_near_the_standard_at_low_frequency() -> None:
    case, omega = study.CASES["low"], np.array([0.005])
    target = study.closed_form(case, omega)
    for kind in study.TYPES.values():
        np.testing.assert_allclose(study.jsbsim_theory(case, kind, omega)[:3], target[:3], rtol=0.01)
