"""How late readings come, what a lever adds, uniform numbers, vibration and Earth's field: each by hand."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Drawn
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import UsageError
from qrsim.models.sensors import earth_field, uniforms, vibration
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.sensors.fitting import LONGEST_DELAY, Fitting, mounted
from qrsim.models.sensors.vibration import Vibration
from qrsim.models.site import Site

EVERY_OTHER = SimpleNamespace(period=0.04, delay=1)


def vec(*values: float) -> Vec3:
    return Vec3(*(jnp.array([value], jnp.float32) for value in values))


@pytest.mark.parametrize(
    ("delay", "jitter", "kept"),
    # Those on their way, up to six spreads of 0.01 s (0.2 periods) late, and the one that was delivered last.
    [(2.0, 0.0, 3), (2.0, 0.01, 5), (1.9, 0.01, 5), (1.7, 0.01, 4), (2.0 + 1e-10, 0.0, 3), (2.0 + 1e-8, 0.0, 4)],
)
def test_readings_that_are_kept(delay: float, jitter: float, kept: int) -> None:
    assert Fitting(delay=delay, jitter=jitter).slots(0.05) == kept


@pytest.mark.parametrize(
    ("normal", "late_s"),
    # Wilson and Hilferty: 0.1 (1 - s^2/9 + s/3 z)^3 for a spread s = 0.2; at most 0.1 + 6 times 0.02.
    [(0.0, 0.0986726), (1.0, 0.1198522), (-1.0, 0.0801477), (10.0, 0.22)],
)
def test_times_on_the_way(normal: float, late_s: float) -> None:
    fitting = Fitting(delay=2.0, jitter=0.02)
    draw = Drawn((jnp.array([normal], jnp.float32),))
    found = fitting.ticks(0.05, 1e-5, draw, (1,))
    assert int(found[0]) == pytest.approx(1e5 * late_s, abs=1.0)
    assert np.asarray(Fitting(delay=2.0).ticks(0.05, 0.01, draw, (1,))).tolist() == [10]


def test_longest_delay_is_fifty_periods() -> None:
    """As docs/howto/choose_sensors.md says."""
    assert LONGEST_DELAY == 50


def test_a_lever_feels_the_change_of_the_rates() -> None:
    """Rates about z from 1 to 2 rad/s in 0.1 s, 1 m ahead: 10 m/s^2 to the right, 1.5^2 backward."""
    fitting = Fitting(position_body=vec(1.0, 0.0, 0.0))
    scene = {
        "rates_body": vec(0.0, 0.0, 2.0),
        "specific_force": vec(0.5, 0.0, -9.0),
        "attitude": Euler(*vec(0, 0, 0).axes),
    }
    found = mounted(fitting, scene, ("specific_force",), vec(0.0, 0.0, 1.0), 0.1)["specific_force"]
    np.testing.assert_allclose(np.ravel(found.stack()), [0.5 - 2.25, 10.0, -9.0], rtol=1e-6)


@pytest.mark.parametrize(("step", "due", "last"), [(0.01, [0, 4, 8], 4), (0.1, [*range(9)], 7)])
def test_ticks_of_readings(step: float, due: list[int], last: int) -> None:
    """Every fourth of those of 0.01 s; of longer ones each. With a delay of one period, that before is held."""
    found = [tick for tick in range(9) if Sensor.fresh(EVERY_OTHER, tick, step)]  # type: ignore[arg-type]
    assert found == due
    assert Sensor.time_of_reading(EVERY_OTHER, 8, step) == last  # type: ignore[arg-type]


class TestUniforms:
    def test_from_nought_to_one_and_no_pair_of_normals(self) -> None:
        """Pairs of words from 2^20 on, so that runs stay what they were."""
        asked: list[Any] = []

        def pairs(numbers: Any) -> Any:
            asked.append(np.asarray(numbers).tolist())
            top = jnp.full((len(numbers), 1), math.sqrt(3.0), jnp.float32)
            return top, -top

        found = uniforms.uniforms(SimpleNamespace(uniform_pairs=pairs), 3, first=5)  # type: ignore[arg-type]
        np.testing.assert_allclose(np.ravel(found), [1.0, 1.0, 0.0], atol=1e-6)
        assert asked == [[1_048_581, 1_048_582]]


class TestVibration:
    """Harmonics 1, 1/2 and 1/3, whose squares sum up to 49/36: 6/7 of each, with the variance of a sine."""

    LEVEL = Vibration(broadband=0.0, gyroscope_x=1.0, gyroscope_y=1.0, gyroscope_z=1.0, accelerometer_x=2.0)  # type: ignore[arg-type]

    def test_waves_by_hand(self) -> None:
        """At a quarter of a turn sin 90, sin 180 / 2, sin 270 / 3; other axes a third and two thirds of a turn on."""
        gyroscope, accelerometer = self.LEVEL.harmonics(jnp.array([0.25]), jnp.array([1.0]))
        sums = np.array([2.0 / 3.0, -0.5 + 0.4330127 - 1.0 / 3.0, -0.5 - 0.4330127 - 1.0 / 3.0])
        np.testing.assert_allclose(np.ravel(gyroscope.stack()), math.sqrt(2.0) * 6.0 / 7.0 * sums, atol=2e-6)
        assert float(accelerometer.x[0]) == pytest.approx(2.0 * math.sqrt(2.0) * 4.0 / 7.0, rel=1e-5)

    def test_rms_over_a_turn(self) -> None:
        phase = jnp.arange(24.0) / 24.0
        gyroscope, _ = self.LEVEL.harmonics(phase, jnp.ones(24))
        np.testing.assert_allclose(np.sqrt(np.mean(np.square(gyroscope.stack()), axis=0)), 1.0, rtol=1e-5)

    def test_what_was_measured(self) -> None:
        """All of it broadband, at the gyroscope alone (docs/evidence/imu.json)."""
        found = vibration.measured()
        assert (found.gyroscope_x, found.gyroscope_y, found.gyroscope_z) == (0.110, 0.098, 0.043)
        assert (found.accelerometer_x, found.accelerometer_y, found.accelerometer_z) == (0.0, 0.0, 0.0)
        assert found.broadband == 1.0


class TestEarthField:
    @pytest.mark.parametrize(
        ("year", "north", "east", "down"),
        # Test values of the models of these years, published with them: 80 N, 0 E, height 0 [nT].
        [
            (2010, 6649.3, -714.8, 54346.2),
            (2015, 6636.6, -451.9, 54408.9),
            (2020, 6570.4, -146.3, 54606.0),
            (2025, 6521.6, 145.9, 54791.5),
        ],
    )
    def test_each_model(self, year: int, north: float, east: float, down: float) -> None:
        when = datetime(year, 1, 1, tzinfo=UTC)
        found = earth_field.earth_field_ned(Site.from_degrees(80.0, 0.0), when)
        np.testing.assert_allclose(found, np.array([north, east, down]) / 1000.0, atol=1e-3)
        last = datetime(year + 4, 12, 31, tzinfo=UTC)
        assert np.linalg.norm(earth_field.earth_field_ned(Site.from_degrees(80.0, 0.0), last) - found) < 0.6

    def test_years(self) -> None:
        assert earth_field.years() == "2010-01-01 to 2029-12-31"
        ends = [datetime(*day, tzinfo=UTC) for day in ((2009, 12, 31), (2010, 1, 1), (2029, 12, 31), (2030, 1, 1))]
        assert [earth_field.covers(when) for when in ends] == [False, True, True, False]
        with pytest.raises(UsageError, match="2010-01-01 to 2029-12-31"):
            earth_field.earth_field_ned(Site.from_degrees(80.0, 0.0), ends[-1])

    def test_longitudes_past_half_a_turn(self) -> None:
        assert [earth_field._within_half_turn(east) for east in (190.0, -190.0, 370.0, 20.0)] == [
            -170.0,
            170.0,
            10.0,
            20.0,
        ]
