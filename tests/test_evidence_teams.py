"""The study of teams in its small form."""

from __future__ import annotations

import pytest
from evidence import teams
from evidence.__main__ import plain


@pytest.mark.long
def test_small_form() -> None:
    found = plain(teams.run(full=False))
    assert found["seeds"] == 1
    formation, orca = found["teams"]["formation"], found["teams"]["orca"]
    # The wedge is 6.4 m off at the start, and finds itself within seconds.
    assert formation["end_error_m"] < 5.0 < formation["begin_error_m"]
    assert orca["least_distance_m"] > 20.0
    assert formation["stopped"] == orca["stopped"] == 0
