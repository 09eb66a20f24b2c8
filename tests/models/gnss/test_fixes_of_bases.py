"""Lost fixes and corrections of a base, which take minutes; tests/models/gnss/test_fixes.py has what is quicker."""

from __future__ import annotations

import numpy as np
import pytest
from tests.models.gnss import flown_receivers as receivers


@pytest.mark.nightly
def test_few_satellites_lose_the_fix_within_a_period() -> None:
    """GPS alone high above the horizon: at times fewer than five."""
    sensor = receivers.receiver(
        "f9p_rtk", systems="G", elevation_mask_rad=np.radians(33.0), first_fix="fixed", fix_time=0.5, period=1.0
    )
    flown = receivers.fly(sensor, 1800.0, 2, base=receivers.base_at(), keep=1, start_s=30000.0)
    few = flown.satellites[:, :, 0] < 5
    assert few.any()
    assert not few.all()
    assert not (flown.fix_type[:, :, 0][few] == 6.0).any()


@pytest.mark.nightly
def test_a_base_takes_away_what_is_common() -> None:
    """DGPS beside the base and far from it, SBAS and none; below the data sheet's 1.0 m of CEP with SBAS."""
    sensors = {
        "none": receivers.receiver("m8n"),
        "sbas": receivers.receiver("f9p_sbas"),
        "dgps": receivers.receiver("m8n", corrections="dgps"),
    }
    places = ((1.0, 0.0, 0.0), (40e3, 0.0, 0.0))
    found = {
        name: receivers.over_a_day(sensor, 4, 20.0, 60, offsets=places, base=receivers.base_at())
        for name, sensor in sensors.items()
    }
    horizontal = {name: np.hypot(f.error[..., 0], f.error[..., 1]).reshape(-1, 2) for name, f in found.items()}
    assert np.median(horizontal["sbas"][:, 0]) < 1.0
    near, far = (np.sqrt(np.mean(horizontal["dgps"][:, i] ** 2)) for i in (0, 1))
    assert near < 0.5 * np.sqrt(np.mean(horizontal["none"][:, 0] ** 2))
    # The slope over 40 km is lost in what each has of its own.
    assert far == pytest.approx(near, rel=0.2)
    assert set(np.unique(found["dgps"].fix_type)) == set(np.unique(found["sbas"].fix_type)) == {4.0}
    for name in ("sbas", "dgps"):
        said = np.sqrt(np.mean(found[name].accuracy[..., 0, :2] ** 2, axis=(0, 1)))
        error = found[name].error[:, :, 0].reshape(-1, 3)
        assert 0.8 < said[0] / np.sqrt(np.mean(error[:, 0] ** 2 + error[:, 1] ** 2)) < 1.25
        assert 0.8 < said[1] / error[:, 2].std() < 1.25
