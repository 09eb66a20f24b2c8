"""What receivers of type ``gnss`` make of satellites: C/N0, ages, weights, accuracies, by (G16) to (G24).

Equations are those of docs/explanation/models/gnss.md, in double precision.
"""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.geometry import (
    View,
    aged,
    carrier_to_noise,
    clear_weakness,
    column,
    geometry_of,
    left_signal,
    multipath_std,
    passed,
    strengths,
    thermal_variance,
    tracked,
    weakness,
)
from qrsim.models.gnss.sight import CommonErrors, Scales, Sight

F32 = np.float32
# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0})

# Nine satellites, the last one below the mask: elevation and azimuth [deg], system (0 GPS, 1 Galileo), ages [s].
ELEVATION = np.radians([80.0, 15.0, 25.0, 35.0, 50.0, 20.0, 65.0, 40.0, 2.0])
AZIMUTH = np.radians([10.0, 50.0, 110.0, 170.0, 230.0, 290.0, 330.0, 140.0, 80.0])
SYSTEM = np.array([0, 1, 0, 1, 0, 0, 1, 0, 0])
# Acquired after 2 s, in full use 4 s later: one has half its weight, and three have not been tracked for 3.3 s.
AGE = np.array([100.0, 100.0, 4.0, 100.0, 3.2, 100.0, 100.0, 3.4, 100.0])
UNIT = np.stack([np.cos(ELEVATION) * np.cos(AZIMUTH), np.cos(ELEVATION) * np.sin(AZIMUTH), -np.sin(ELEVATION)], -1)
# Mappings and where rays cross the ionosphere [km], given.
IONOSPHERE = 1.0 / np.sin(ELEVATION + 0.3)
TROPOSPHERE = 1.0 / np.sin(ELEVATION + 0.05)
NORTH, EAST = 300.0 * UNIT[:, 0], 300.0 * UNIT[:, 1]
SIGNAL_STD = np.array([0.6, 0.2, 0.6, 0.2, 0.6, 0.6, 0.2, 0.6, 0.6])
NUMBERS = np.random.default_rng(11).normal(size=(12, 9))
RECEIVER: dict[str, Any] = {
    "frequencies": "single", "systems": "GE", "corrections": "none", "takes_base": False, "moving_base": "",
    "cn0_zenith": 44.0, "multipath": 1.5, "code_bandwidth": 2.0, "correlator_spacing": 0.5, "loop_time": 3.0,
    "smoothing_time": 10.0, "float_time": 60.0, "multipath_time": 8.0, "multipath_slow_time": 200.0, "period": 0.2,
    "acquisition": 2.0, "entry": 4.0, "reacquisition": 1.0, "reacquisition_long": 30.0, "doppler_noise": 0.06,
    "system_bias": 0.7,
}  # fmt: skip


def receiver_of(**changes: Any) -> Any:
    return SimpleNamespace(**{**RECEIVER, **changes})


def f32(values: Any) -> Any:
    return np.asarray(values, F32)


def common(first: int) -> Any:
    """Return common errors, by the table of numbers."""
    return CommonErrors(*(f32(scale * NUMBERS[first + i]) for i, scale in enumerate((1.0, 1.0, 1.0, 1.0, 1.0, 0.3))))


def slots_of(**changes: Any) -> Any:
    """Return the nine satellites in slots."""
    numbers: Any = [f32(v) for v in (ELEVATION, IONOSPHERE, TROPOSPHERE, NORTH, EAST)]
    scales: Any = Scales(f32(SIGNAL_STD), 0.12, (1.5, 0.5), (2e-3, 3e-4), (0.35, 0.2), (2.0, 0.5))  # type: ignore[arg-type]
    base = SimpleNamespace(multipath=F32(2.0), code_before=f32(NUMBERS[0]), code_after=f32(NUMBERS[7]))
    usual: dict[str, Any] = {
        "sight": Sight(Vec3(*(f32(axis) for axis in UNIT.T)), *numbers),
        "scales": scales,
        "system": SYSTEM,
        "before": common(0),
        "after": common(6),
        "rough": False,
        "own": None,
        "base": base,
        "knot": np.int32(0),
        "part": F32(0.5),
        "knot_s": 5.0,
    }
    return SimpleNamespace(**{**usual, **changes})


def geometry(receiver: Any, slots: Any, view: View | None = None) -> Any:
    """Return the geometry with all satellites but the last one."""

    @jit
    def run(age: Any, view: Any) -> Any:
        return geometry_of(receiver, slots, jnp.asarray((np.arange(9) < 8)[:, None]), age, view)

    return run(f32(AGE)[:, None], view)


# The same by the equations


def sigma_mp() -> Any:
    """(G16): 1.5 (0.13 m + 0.53 m exp(-e/10 deg))."""
    return 1.5 * (0.13 + 0.53 * np.exp(-np.degrees(ELEVATION) / 10.0))


def weaker() -> Any:
    """10^((45 - C)/10), C = 44 - 10 (1 - sin e) dB-Hz."""
    return 10.0 ** (0.1 * (45.0 - (44.0 - 10.0 * (1.0 - np.sin(ELEVATION)))))


def thermal() -> Any:
    """(293.05 m)^2 B d/(2 10^(C/10)), with B d = 1 Hz: 1.35782 m^2 at 45 dB-Hz."""
    return 293.05**2 / 2.0 / 10.0**4.5 * weaker()


def weights(signal: float = 1.0, left: float = 1.0) -> tuple[Any, Any]:
    """(G17): weights and the variances they are of, for one frequency, with what SBAS leaves."""
    variance = (
        sigma_mp() ** 2
        + thermal()
        + (signal * SIGNAL_STD) ** 2
        + (0.5 * left * 1.5 * IONOSPHERE) ** 2
        + (0.12 * TROPOSPHERE) ** 2
        + 0.15 * np.maximum(weaker() - 1.0, 0.0)
    )
    ramp = np.clip((AGE - 2.0) / 4.0, 0.0, 1.0) * (np.arange(9) < 8)
    return ramp / variance, variance


def matrix(weight: Any) -> Any:
    """A of (G17), (3, 9)."""
    design = np.column_stack([-UNIT, np.ones(9)])
    return (np.linalg.inv((design * weight[:, None]).T @ design) @ (design * weight[:, None]).T)[:3]


def share(rate: float, second: float = 10.0) -> float:
    """f of (G19)."""
    a, b, c = rate, 1.0 / 3.0, 1.0 / second
    return b * c * (a + b + c) / ((a + b) * (a + c) * (b + c))


def own_variance(second: float = 10.0) -> Any:
    """f own^2: both halves of multipath, of 8 s and 200 s, and white noise, a rate of 2/T."""
    halves = 0.5 * (share(1.0 / 8.0, second) + share(1.0 / 200.0, second))
    return sigma_mp() ** 2 * halves + thermal() * share(2.0 / 0.2, second)


def level_and_height(covariance: Any) -> list[float]:
    return [math.sqrt(covariance[0, 0] + covariance[1, 1]), math.sqrt(covariance[2, 2])]


# Numbers of one satellite


def one_satellite(sine: float) -> Any:
    sight = SimpleNamespace(line_of_sight=SimpleNamespace(z=f32([-sine])), elevation=f32([math.asin(sine)]))
    return SimpleNamespace(sight=sight)


def test_carrier_to_noise_and_what_is_weaker() -> None:
    """C = cn0_zenith - 10 (1 - sin e): 50 at the zenith, 47 at a sine of 0.7; 45 dB-Hz have a weakness of 1."""
    receiver = receiver_of(cn0_zenith=50.0)

    @jit
    def run(up: Any) -> Any:
        one = one_satellite(0.7)
        return (
            carrier_to_noise(receiver, up),
            weakness(receiver, one)[0, 0],
            weakness(receiver, one, loss=12.0)[0, 0],
            strengths(receiver, one)[0, 0],
            clear_weakness(receiver),
        )

    found = [float(value) for value in run(F32(0.7))]
    assert found == pytest.approx([47.0, 0.63095734, 10.0, 47.0, 0.31622777], rel=1e-5)


def test_thermal_noise_and_multipath() -> None:
    """(293.05 m)^2 0.5 Hz 0.2/(2 10^4.5) is 0.135782 m^2; DO-229D's 0.13 + 0.53/e at 10 deg, 0.13 + 0.53/e^2 at 20."""
    receiver = receiver_of(code_bandwidth=0.5, correlator_spacing=0.2, multipath=1.0)
    assert float(thermal_variance(receiver)) == pytest.approx(0.1357867, rel=1e-4)
    for degrees, std in ((10.0, 0.3249761), (20.0, 0.2017277)):
        found = multipath_std(receiver, one_satellite(math.sin(math.radians(degrees))))
        assert float(found[0, 0]) == pytest.approx(std, rel=1e-5)


def test_what_both_lags_let_pass() -> None:
    """(G19): rates of 0.01, 1/3 and 1/10 per second: 1/30 0.44333/(0.34333 0.11 0.43333) = 0.902989."""
    receiver = receiver_of()
    assert float(passed(receiver, 0.01)) == pytest.approx(0.902989, rel=1e-5)
    # A second lag of 60 s: 1/180 0.36/(0.343333 0.0266667 0.35) = 0.624133.
    assert float(passed(receiver, 0.01, 60.0)) == pytest.approx(0.624133, rel=1e-5)


def test_corrections_of_satellites_halve_clocks() -> None:
    assert left_signal(receiver_of(corrections="sbas")) == 0.5
    assert left_signal(receiver_of()) == 1.0
    assert [column(receiver_of(frequencies=name)) for name in ("single", "dual")] == [0, 1]


def test_satellites_are_lost_at_25_and_found_at_33() -> None:
    """A weakness of 99 and 101 is 25.04 and 24.96 dB-Hz; of 15.7 and 16.0 it is 33.04 and 32.96."""
    receiver, slots = receiver_of(cn0_zenith=45.0), one_satellite(1.0)
    here: Any = np.ones((1, 4), bool)
    kept = jit(lambda age, jam: tracked(receiver, slots, here, age, jam))(
        f32([[50.0, 50.0, -1010.0, -1010.0]]), f32([98.0, 100.0, 14.7, 15.0])
    )
    np.testing.assert_array_equal(kept, [[True, False, True, False]])


def test_ages_a_period_later() -> None:
    rows = [
        (True, 100.0, 100.2),
        # No older than a million seconds.
        (True, 1.1e6, 1e6),
        # Found anew 1 s or 30 s before it is used again, which is at an age of 2 s.
        (True, -1059.0, 1.2),
        (True, -1061.0, -27.8),
        # What is not seen counts downwards from -1000, for nine thousand seconds.
        (False, 100.0, -1000.2),
        (False, -1059.0, -1059.2),
        (False, -11000.0, -10000.2),
    ]
    seen, age, later = (np.array(column)[:, None] for column in zip(*rows, strict=True))
    same: Any = np.ones((7, 1), bool)
    found = jit(lambda seen, age: aged(receiver_of(), seen, same, age))(seen, f32(age))
    np.testing.assert_allclose(found, later, atol=2e-3)


# The whole solution


@pytest.mark.parametrize(("corrections", "signal", "left"), [("none", 1.0, 1.0), ("sbas", 0.5, 0.25)])
def test_solution_and_accuracies_of_one_frequency(corrections: str, signal: float, left: float) -> None:
    """(G17), (G19), and with SBAS half of the clocks and a quarter of the ionosphere.

    Without, nobody asks what of the signal is weather, and what is not told does not matter.
    """
    told = slots_of()
    if signal == 1.0:
        told = slots_of(before=replace(told.before, weather=f32(np.full(9, np.nan))))
    found = geometry(receiver_of(corrections=corrections), told)
    a = matrix(weights(signal, left)[0])
    clear = [(a @ NUMBERS[i : i + 6].T).T for i in (0, 6)]
    for part, (clock, delay, _, _, _, weather) in zip((found.before, found.after), clear, strict=True):
        expected = signal * clock + (1.0 - signal) * 0.3 * weather + left * delay
        np.testing.assert_allclose(part.stack()[0], expected, rtol=1e-3, atol=1e-3)
    # A slope of 2 m/km after one frequency, per metre.
    for part, row in ((found.slope_north, 3), (found.slope_east, 4)):
        np.testing.assert_allclose(part.stack()[0], left * 2e-3 * (a @ NUMBERS[row]), rtol=1e-3, atol=2e-6)
    half = (a * sigma_mp()).T / math.sqrt(2.0)
    np.testing.assert_allclose(found.multipath.stack()[:, 0, :], half, rtol=1e-3, atol=1e-3)
    each = own_variance() + (signal * SIGNAL_STD) ** 2 + (left * 0.35 * IONOSPHERE) ** 2
    together = [
        (left * 1.5, IONOSPHERE),
        (0.12, TROPOSPHERE),
        (0.7, SYSTEM),
        (left * 2e-3, IONOSPHERE * NORTH),
        (left * 2e-3, IONOSPHERE * EAST),
    ]
    covariance = a * each @ a.T + sum(std**2 * np.outer(a @ f, a @ f) for std, f in together)
    level, height = level_and_height(covariance)
    assert float(found.horizontal[0]) == pytest.approx(level, rel=1e-3)
    assert float(found.vertical[0]) == pytest.approx(height, rel=1e-3)
    assert float(found.speed[0]) == pytest.approx(0.06 * math.sqrt(np.trace(a * weaker() @ a.T)), rel=1e-3)


@pytest.mark.parametrize("moving", ["", "a_0"])
def test_accuracies_against_a_base_and_satellites_that_are_strong(moving: str) -> None:
    """Own errors, and those of a base: twice its multipath of (G16), at 0.01 per second, or those of a like receiver.

    Offsets of systems differ between two receivers, sqrt(2) times as much. Phase is fixed with satellites above
    35 dB-Hz, weaker than 10 times by less, that have been tracked for 3 s, after (G24).
    """
    receiver = receiver_of(takes_base=True, moving_base=moving, cn0_zenith=44.0)
    found = geometry(receiver, slots_of()).differential
    weight, _ = weights()
    a = matrix(weight)
    base = (2.0 / 1.5 * sigma_mp()) ** 2
    offset = (2.0 if moving else 1.0) * 0.7**2 * np.outer(a @ SYSTEM, a @ SYSTEM)
    for second, names in ((10.0, ("horizontal", "vertical")), (60.0, ("float_horizontal", "float_vertical"))):
        other = own_variance(second) if moving else share(0.01, second) * base
        expected = level_and_height(a * (own_variance(second) + other) @ a.T + offset)
        assert [float(getattr(found, name)[0]) for name in names] == pytest.approx(expected, rel=1e-3)
    if not moving:
        for part, row in ((found.before, 0), (found.after, 7)):
            np.testing.assert_allclose(part.stack()[0], -(a @ (np.sqrt(base) * NUMBERS[row])), rtol=1e-3, atol=1e-3)


def test_phase_is_fixed_with_what_is_strong_and_has_been_tracked() -> None:
    """C/N0 of 35.1 and 34.9 at the lowest sine used, 0.258819: of eight, all or all but one; 3.1 s or 2.9 s for one.

    Three receivers, among which nothing else differs.
    """
    zenith = f32([42.512, 42.312, 42.512])
    receiver = receiver_of(takes_base=True, moving_base="a_0", cn0_zenith=zenith, acquisition=1.0)
    ages = np.full((9, 3), 100.0)
    ages[3] = 3.1, 3.1, 2.9

    @jit
    def run(age: Any) -> Any:
        seen = jnp.asarray(np.broadcast_to((np.arange(9) < 8)[:, None], (9, 3)))
        return geometry_of(receiver, slots_of(), seen, age).differential.strong

    np.testing.assert_array_equal(run(f32(ages)), [8.0, 7.0, 7.0])


def test_ranges_that_do_not_fit_lose_weight() -> None:
    """(G22): twice again with 2 sigma/|r| of the weight beyond 2 sigma; errors are extra + sigma m/sqrt(2)."""
    both, extra = np.zeros(9), np.zeros(9)
    both[4], extra[7] = 60.0, 3.0
    counted: Any = np.ones((9, 1), bool)
    loss, reflected, multipath = (f32(v)[:, None] for v in (0.0 * both, extra, both))
    view = View(loss, reflected, multipath, counted)
    zero = CommonErrors(*(f32(np.zeros(9)) for _ in range(6)))
    found = geometry(receiver_of(), slots_of(before=zero, after=zero), view)
    weight, variance = weights()
    errors = extra + sigma_mp() * both / math.sqrt(2.0)
    design, now = np.column_stack([-UNIT, np.ones(9)]), weight
    for _ in range(2):
        normal = (design * now[:, None]).T
        left = np.abs(errors - design @ np.linalg.solve(normal @ design, normal @ errors)) / np.sqrt(variance)
        assert np.max(left[:8]) < 6.0
        now = weight * np.where(left < 2.0, 1.0, 2.0 / np.maximum(left, 2.0))
    assert now[4] < 0.7 * weight[4]
    np.testing.assert_allclose(found.own.gains.weight[:, 0], now, rtol=1e-3)
