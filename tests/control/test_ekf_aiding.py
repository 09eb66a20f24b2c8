"""The Kalman filter with magnetometer, airspeed and a barometer that drifts; what it says of itself."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from tests.by_numpy import by_numpy
from tests.control.kalman_rig import EARTH_FIELD, Magnetic, errors, filtered, flown, matched, with_all

from qrsim.control.consistency import Truth, normalised
from qrsim.control.covariance import matrix, variances
from qrsim.control.kalman_readings import airspeeds, compass, fields, heights
from qrsim.control.kalman_state import Inner, KalmanState, injected, inner_std
from qrsim.control.setpoints import Estimate
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3

ONE = np.ones(1, np.float32)
START = Estimate(
    Vec3(3.0 * ONE, -2.0 * ONE, -20.0 * ONE),
    Vec3(4.0 * ONE, 1.0 * ONE, -0.5 * ONE),
    Euler(0.2 * ONE, -0.1 * ONE, 2.0 * ONE),
)


def vec(*axes: float) -> Vec3:
    return Vec3(*(np.array([axis], np.float32) for axis in axes))  # type: ignore[arg-type]


def reading(**fields: Any) -> Any:
    return SimpleNamespace(**fields, __dataclass_fields__=dict(fields))


def readings(**change: Any) -> dict[str, Any]:
    given = {
        "gnss": reading(position_ned=START.position_ned, velocity_ned=START.velocity_ned),
        "imu": reading(rates_body=vec(0.0, 0.0, 0.0), specific_force=vec(0.0, 0.0, -9.81)),
        "barometer": reading(height=20.0 * ONE),
        "magnetometer": reading(field_body=vec(10.0, -5.0, 45.0)),
        "pitot": reading(true_airspeed=7.0 * ONE),
    }
    return {name: sensor for name, sensor in {**given, **change}.items() if sensor is not None}


def one_error(k: int, size: float) -> Any:
    return jnp.asarray(np.eye(24)[k][:, None] * size, jnp.float32)


@pytest.fixture
def state() -> KalmanState:
    """Of one vehicle, with biases, wind and all 24 errors."""
    found = with_all().init(readings(), START)[0]
    inner = replace(
        found.inner, field_bias=vec(0.5, -1.0, 0.3), wind_north=2.0 * ONE, wind_east=-3.0 * ONE, height_bias=0.4 * ONE
    )
    return replace(found, inner=inner)


def seen(state: KalmanState) -> tuple[Vec3, Any, Any]:
    """What ideal sensors say in a state: field in body axes, airspeed, height."""
    rotation, inner = state.rotation, state.inner
    assert inner.earth_field_ned is not None
    assert inner.field_bias is not None
    air = state.velocity_ned - Vec3(inner.wind_north, inner.wind_east, 0.0)  # type: ignore[arg-type]
    height = -state.position_ned.z - state.position_low_ned.z + inner.height_bias
    return rotation.to_body(inner.earth_field_ned) + inner.field_bias, rotation.forward.dot(air), height


def test_readings_depend_on_errors_as_they_are_said_to(state: KalmanState):
    """Each of the 24 errors, made real one by one, changes what ideal sensors say by the factor of the filter."""
    small = 2e-3
    innovations = {
        "field": lambda said: fields(state, said[0], ONE),
        "airspeed": lambda said: airspeeds(state, said[1], ONE),
        "height": lambda said: heights(state, said[2], ONE),
    }
    for k in range(24):
        there, back = (seen(injected(state, one_error(k, size), 0.02)) for size in (small, -small))
        for name, of in innovations.items():
            for scalar, other in zip(of(there), of(back), strict=True):
                factor = float(scalar.sensitivity.get(k, jnp.zeros(1))[0])
                slope = float(scalar.innovation[0] - other.innovation[0]) / (2.0 * small)
                assert slope == pytest.approx(factor, abs=0.02), (name, k)


def test_a_compass_depends_on_tilt_by_the_vertical_field(state: KalmanState):
    """The same of the heading by a levelled field, from that of the Earth without a bias."""
    small, calm = 2e-3, replace(state, inner=replace(state.inner, field_bias=vec(0.0, 0.0, 0.0)))
    declination = jnp.arctan2(EARTH_FIELD[1], EARTH_FIELD[0])
    for k in (6, 7, 8):
        really = injected(calm, one_error(k, small), 0.02)
        (scalar,) = compass(calm, seen(really)[0], declination, ONE)
        assert float(scalar.innovation[0]) / small == pytest.approx(float(scalar.sensitivity[k][0]), abs=0.02)
    # 44 uT down, 20 uT north: a tilt of one degree turns a compass by 2.2.
    assert float(scalar.sensitivity[6][0]) == pytest.approx(-44.0 * 20.0 / (20.0**2 + 1.5**2), rel=0.02)


@pytest.mark.parametrize(
    ("change", "given", "size"),
    [
        ({}, readings(magnetometer=None, pitot=None), 15),
        ({}, readings(pitot=None), 21),
        ({}, readings(magnetometer=None), 17),
        ({"magnetometer": "heading"}, readings(pitot=None), 15),
        ({"height_bias": True}, readings(magnetometer=None, pitot=None), 16),
        ({"height_bias": True}, readings(magnetometer=None, pitot=None, barometer=None), 15),
        ({"height_bias": True}, readings(), 24),
    ],
)
def test_what_is_estimated_goes_by_the_sensors(change: dict[str, Any], given: dict[str, Any], size: int):
    kalman = replace(matched(), **change)
    found = kalman.init(given, START)[0]
    # In blocks of three.
    assert matrix(found.covariance).shape == (-(-size // 3) * 3,) * 2 + (1,)
    assert len(_leaves(inner_std(found))) == size - 9


def _leaves(inner: Inner) -> list[Any]:
    parts = [getattr(inner, name) for name in inner.__dataclass_fields__]
    return [axis for part in parts if part is not None for axis in (part.axes if isinstance(part, Vec3) else [part])]


def test_the_start_is_what_is_known_of_it():
    """The yaw of the start, the Earth's field of the site, and the default std of each: 0.03 rad, 0.15, 2 uT, 6 m/s."""
    found = with_all().init(readings(), START)[0]
    assert float(found.attitude.euler().yaw[0]) == pytest.approx(2.0)
    assert [float(axis[0]) for axis in found.inner.earth_field_ned.axes] == pytest.approx(EARTH_FIELD)  # type: ignore[union-attr]
    stds = [float(jnp.sqrt(variances(found.covariance)[k][0])) for k in (8, 15, 18, 21, 23)]
    assert stds == pytest.approx([0.03, 0.15, 2.0, 6.0, 0.5])
    own = inner_std(found)
    stds = [own.gyroscope_bias.x, own.accelerometer_bias.z, own.earth_field_ned.y, own.field_bias.x]  # type: ignore[union-attr]
    stds += [own.wind_north, own.wind_east, own.height_bias]
    assert [float(std[0]) for std in stds] == pytest.approx([0.01, 0.1, 0.15, 2.0, 6.0, 6.0, 0.5])
    # With a bias the first height is that of the fix.
    assert float(variances(found.covariance)[2][0]) == pytest.approx(2.5**2)


def test_a_slow_airspeed_is_not_believed():
    """Below 5 m/s a pitot tube says nothing."""
    kalman = matched()
    for airspeed, believed in ((4.9, False), (5.1, True)):
        given = readings(magnetometer=None, pitot=reading(true_airspeed=airspeed * ONE))
        groups = kalman._groups(kalman.init(given, START)[0], given, dict.fromkeys(given, jnp.array(True)), 0.02)
        found = {what: bool(new[0]) for what, _, new, _ in groups}
        assert found == {"position_ned": True, "velocity_ned": True, "height": True, "airspeed": believed}


@pytest.mark.long
def test_the_squares_are_those_of_matrices():
    """Over the number of errors; of two vehicles, one of which errs by nothing."""
    half = np.random.default_rng(3).normal(size=(6, 6))
    covariance = (half @ half.T + np.eye(6)) * np.outer(scale := np.logspace(-3, 1, 6), scale)
    wrong = np.random.default_rng(4).normal(size=6) * scale
    found = jax.jit(normalised)(
        jnp.asarray(np.repeat(covariance[:, :, None], 2, axis=2), jnp.float32),
        jnp.asarray(np.stack([wrong, 0.0 * wrong], axis=-1), jnp.float32),
    )
    expected = wrong @ np.linalg.inv(covariance) @ wrong / 6.0
    np.testing.assert_allclose(found, [expected, 0.0], rtol=1e-3)


@pytest.mark.long
def test_blocks_are_of_their_own_errors():
    """1.5 m std beside 3 m north: 4 of three; a yaw of 0.1 rad beside 0.05: 4 of three; without biases nine count."""
    kalman = replace(matched(), heading_std=jnp.float32(0.05))

    def consistency(*given: Any) -> Any:
        return by_numpy(kalman.consistency, [given])[0]

    given = readings(magnetometer=None, pitot=None, barometer=None)
    state, _ = kalman.init(given, replace(START, attitude=Euler(0.0 * ONE, 0.0 * ONE, 2.0 * ONE)))
    truth = Truth(START.position_ned + vec(3.0, 0.0, 0.0), START.velocity_ned, Euler(0.0 * ONE, 0.0 * ONE, 2.1 * ONE))
    found = consistency(state, truth)
    values = [float(getattr(found, name)[0]) for name in ("every", "position", "velocity", "attitude", "bias")]
    assert values[:4] == pytest.approx([8.0 / 9.0, 4.0 / 3.0, 0.0, 4.0 / 3.0], rel=0.01)
    assert np.isnan(values[4])
    # A bias of 0.02 rad/s beside 0.01: 4 of six.
    truth = replace(truth, gyroscope_bias=vec(0.0, 0.02, 0.0), accelerometer_bias=vec(0.0, 0.0, 0.0))
    found = consistency(state, truth)
    assert [float(found.bias[0]), float(found.every[0])] == pytest.approx([4.0 / 6.0, 12.0 / 15.0], rel=0.01)


@pytest.mark.parametrize(
    ("ticks", "count", "late"),
    [
        pytest.param(160, 64, 15, marks=pytest.mark.long),
        *(pytest.param(600, 100, late, marks=pytest.mark.nightly) for late in (0, 15)),
    ],
)
def test_all_errors_are_as_large_as_stated(ticks: int, count: int, late: int):
    """All 24, with fixes on time and late: each sum over the vehicles is inside its 99.9 % band."""
    kalman = replace(with_all(), ages=(("gnss", late),) if late else ())
    truth = flown(ticks, count, np.random.default_rng(1))
    states, biases = filtered(kalman, truth, 2, late)
    low, high = scipy.stats.chi2.ppf([0.0005, 0.9995], 24 * count)
    for k in np.linspace(ticks // 5, ticks, 5).astype(int):
        found, stated = errors(states, truth, biases, k)
        nees = np.einsum("ni,nij,nj->", found, np.linalg.inv(stated), found)
        assert low < nees < high, (k, nees / count)


def test_headings_of_others_give_way_to_a_magnetometer():
    """The yaw of an attitude counts where no magnetometer is carried, and not beside one."""
    tilted = reading(attitude=Euler(0.2 * ONE, -0.1 * ONE, 2.02 * ONE))
    for name, given in (("yaw", readings(magnetometer=None, compass=tilted)), ("field", readings(compass=tilted))):
        kalman = with_all()
        state = kalman.init(given, START)[0]
        kinds = [what for what, _, _, _ in kalman._groups(state, given, dict.fromkeys(given, jnp.array(True)), 0.02)]
        assert kinds == ["position_ned", "velocity_ned", "height", name, "airspeed"]


@pytest.mark.long
def test_a_field_turns_the_filter_towards_what_it_says():
    """20 uT to the north: a vehicle that faces 0.1 rad further east than it thinks is turned by two thirds of it."""
    kalman = replace(with_all(), field_bias_std=0.0, tilt_std=0.0, heading_std=0.05, earth_field_std=0.5)
    begin = replace(START, attitude=Euler(0.0 * ONE, 0.0 * ONE, 0.0 * ONE))
    true = Quaternion.of(Euler(0.0 * ONE, 0.0 * ONE, 0.1 * ONE)).rotation().to_body(vec(*EARTH_FIELD))
    given = readings(magnetometer=Magnetic(true), pitot=None)
    fresh = {name: jnp.array(name == "magnetometer") for name in given}
    (estimate,) = by_numpy(lambda: kalman.step(kalman.init(given, begin)[0], given, fresh, 1e-4)[1], [()])
    # Yaw 0.05 rad; a field of 20.06 uT with noise and uncertainty of 0.5 uT each: 0.067 rad.
    share = 0.05**2 / (0.05**2 + 2.0 * (0.5 / 20.06) ** 2)
    assert float(estimate.attitude.yaw[0]) == pytest.approx(0.1 * share, rel=0.05)
