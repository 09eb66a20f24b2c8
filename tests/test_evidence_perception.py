"""The small form of the study of scans among buildings (``make evidence perception``)."""

from __future__ import annotations

import pytest
from evidence import perception as study


@pytest.mark.long
def test_scans_end_where_an_independent_geometry_says() -> None:
    found = study.run(False)
    assert found["rays"] == 48
    assert found["returned"] > 0.7
    assert found["at_edges"] <= 1
    assert found["largest_difference_m"] < 1e-3
    # 99.9 % of the spread of some 40 ranges of 3 cm.
    assert found["noise_std_m"] == pytest.approx(0.03, rel=0.37)
