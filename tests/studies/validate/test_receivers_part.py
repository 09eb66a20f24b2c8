"""The part of the validation about receivers and geometry."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.studies.validate import receivers as part


def test_geometry_is_that_of_the_nominal_constellation() -> None:
    """24 slots over 5 degrees: a median PDOP of 1.8; of sites at a pole as many as their parallel is long."""
    found = part.pdops(24)
    assert found.shape == (138, 24)
    assert np.median(found) == pytest.approx(1.79, abs=0.05)
    assert np.mean(found <= part.SPS_PDOP) >= part.SPS_PDOP_SHARE


def of(error: float, reported: float, count: int = 4000) -> part.Fixes:
    """Return fixes with normal errors of a size, and what is reported of them, per axis [m]."""
    errors = error * np.random.default_rng(5).standard_normal((count, 3))
    return part.Fixes(errors, np.tile(reported * np.array([np.sqrt(2.0), 1.0]), (count, 1)))


def test_a_receiver_that_is_wrong_about_itself_fails() -> None:
    """Errors of 1 m: reported as such, and 20 % less or more."""
    assert all(check.passed for check in part.honest("m8n", of(1.0, 1.0), 4))
    for wrong in (1.2, 1.0 / 1.2):
        assert not any(check.passed for check in part.honest("m8n", of(1.0, wrong), 4))


def test_the_circle_of_half_of_the_fixes_is_held_against_the_data_sheet() -> None:
    """CEP of normal errors is 1.1774 times those of an axis; u-blox promises 2.5 m of the M8N."""
    assert part.cep(of(1.0, 1.0)) == pytest.approx(1.1774, rel=0.03)
    verdicts = [part._cep_finding("m8n", found).verdict for found in (0.9, 1.3, 2.4, 2.6)]
    assert verdicts == ["fits in part", "fits", "fits", "does not fit"]


@pytest.mark.long
def test_more_multipath_is_reported_as_such() -> None:
    """The preset m8n, and with three times its multipath: both are right about themselves, one is worse."""
    own, worse = (part.fixes("m8n", 2, 60, **change) for change in ({}, {"multipath": 7.5}))
    for each in (own, worse):
        assert all(check.passed for check in part.honest("m8n", each, 2))
    assert np.mean(worse.reported[:, 0]) > 1.05 * np.mean(own.reported[:, 0])
