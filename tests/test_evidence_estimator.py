"""The small form of the study of the Kalman filter (``make evidence estimator``)."""

from __future__ import annotations

import numpy as np
import pytest
from evidence import estimator as study

pytestmark = pytest.mark.long


def test_coloured_errors_of_fixes_are_not_what_the_filter_states():
    """White ones, on time and late, are; 15 errors and 60 vehicles: 99.9 % of means are within 2.4 of 15."""
    truth = study.flown(300, 60, np.random.default_rng(1))
    found = {
        name: study.normalised(study.matched(), truth, [300], late, colour).mean(axis=1)[0]
        for name, late, colour in (("white", 0, False), ("late", 15, False), ("coloured", 0, True))
    }
    for name in ("white", "late"):
        assert abs(found[name][0] - 15.0) < 2.4
        assert abs(found[name][1] - 3.0) < 1.1
    assert found["coloured"][1] > 15.0
