"""What airspeed a vehicle holds: the identified one's balance by hand, and found for one without a formula."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from qrsim.core.tree import record
from qrsim.models.vehicles.envelope import envelope
from qrsim.models.vehicles.fixed_point import FixedPoint
from qrsim.models.vehicles.quadrotor import Quadrotor


@record
class Unknown(Quadrotor):
    """The identified quadrotor, if nobody had solved its equations."""

    def leaning(self, tilt: Any) -> Any:
        return None


@pytest.mark.parametrize(("airspeed", "degrees", "thrust"), [(12.0, 31.4, 16.8), (14.0, 35.4, 19.0)])
def test_the_pelican_in_balance(airspeed: float, degrees: float, thrust: float) -> None:
    """Tilt and specific thrust [m/s^2] of eq. 6 with nothing moving."""
    tilts = np.linspace(0.1, 0.8, 1401)
    speeds, newtons = Quadrotor().leaning(tilts)
    assert np.degrees(np.interp(airspeed, speeds, tilts)) == pytest.approx(degrees, abs=0.1)
    assert np.interp(airspeed, speeds, newtons) / 1.68 == pytest.approx(thrust, abs=0.05)


def test_the_most_that_the_pelican_holds() -> None:
    """At 12 V its thrust ends at 32.85 N; with 25 degrees of lean it holds g tan(25 deg)/0.497391."""
    found = envelope(Quadrotor(), [1.0, math.radians(25.0)])
    assert found is not None
    assert found.airspeed == pytest.approx([14.5, 9.197], abs=0.03)
    assert found.thrust[0] == pytest.approx(32.85, abs=0.01)
    assert found.by_thrust.tolist() == [True, False]
    weaker = envelope(Quadrotor(), 1.0, 25.0)
    assert weaker is not None
    assert weaker.thrust == pytest.approx([25.0])
    assert weaker.airspeed[0] < 11.0


@pytest.mark.long
def test_found_without_a_formula() -> None:
    """By the vehicle's own specific force, for each vehicle by its own numbers."""
    for vehicle in (Unknown(), Unknown(mass=np.array([1.68, 1.4]), kw=np.array([-1.0, -2.0]))):  # type: ignore[arg-type]
        own = envelope(Quadrotor(mass=vehicle.mass, kw=vehicle.kw), [1.0, 0.4])
        found = envelope(vehicle, [1.0, 0.4])
        assert own is not None
        assert found is not None
        assert found.airspeed == pytest.approx(own.airspeed, rel=1e-4)
        assert found.thrust == pytest.approx(own.thrust, rel=1e-4)
        assert found.by_thrust.tolist() == own.by_thrust.tolist() == [True, False]


def test_without_drag_nothing_carries_it_away_and_without_tilt_there_is_no_envelope() -> None:
    found = envelope(Quadrotor(kuv=0.0), 0.5)
    assert found is not None
    assert np.isinf(found.airspeed).all()
    assert envelope(FixedPoint(), 0.5) is None
