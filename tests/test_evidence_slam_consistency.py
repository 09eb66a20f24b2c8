"""What range-only SLAM says of its own errors: the small form of the study, and its statistics against literals."""

from __future__ import annotations

import numpy as np
import pytest
from evidence import slam_consistency as study
from evidence.__main__ import plain


def test_nees_is_the_squared_error_in_standard_deviations() -> None:
    """2 m at 4 m^2 and 3 m at 1 m^2: 1 + 9; 2 m twice at 1 m^2, correlated by a half: (4 + 4 - 4) / 0.75."""
    assert study.nees(np.array([2.0, 3.0]), np.diag([4.0, 1.0])) == pytest.approx(10.0)
    assert study.nees(np.array([2.0, 2.0]), np.array([[1.0, 0.5], [0.5, 1.0]])) == pytest.approx(16.0 / 3.0)


def test_the_band_of_fifty_seeds() -> None:
    """Chi-square of 100 degrees of freedom, 74.222 and 129.561 (tables), over 50."""
    assert study.band(50, 2) == pytest.approx((74.222 / 50, 129.561 / 50), rel=1e-5)


@pytest.mark.long
def test_coloured_errors_taken_for_white_make_it_too_sure_of_itself() -> None:
    """White inside its band; coloured above by far; as a state inside again."""
    found = study.run(full=False)
    # What a file of evidence can hold.
    assert plain(found, "") == found
    assert found["white"]["position"]["inside"]
    assert found["coloured"]["position"]["nees"] > 5.0 * found["coloured"]["position"]["band_high"]
    assert found["coloured"]["position"]["coverage"]["high"] < 0.95
    assert found["coloured_as_state"]["position"]["inside"]
