"""From a link's length to the chance of loss, against numbers from outside."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Draw, Key
from qrsim.core.vectors import Vec3
from qrsim.models.radio import propagation as way
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle, Obstacles
from qrsim.models.scene.prisms import PrismObstacle, prisms_of
from qrsim.models.scene.rays import walls_between


def f32(*values):
    return jnp.asarray(np.float32(values))


def test_free_space_and_the_log_distance_law():
    """Friis: 46.684 dB in the first metre at 5.15 GHz, as ns-3 has it; 31.68 dB at 915 MHz; 22 dB per decade at 2.2."""
    first = way.path_loss(f32(1.0), jnp.float32(5.15e9), jnp.float32(3.0))
    np.testing.assert_allclose(first, 46.684, atol=2e-3)
    loss = way.path_loss(f32(0.25, 1.0, 100.0, 1e4), jnp.float32(915e6), jnp.float32(2.2))
    np.testing.assert_allclose(loss, [31.68, 31.68, 53.68, 75.68], atol=5e-3)


def test_noise_of_a_receiver():
    """Over 250 kHz with 6 dB it is -174 + 53.98 + 6 dBm."""
    np.testing.assert_allclose(way.noise_floor(250e3, jnp.float32(6.0)), -114.02, atol=5e-3)


def test_man_made_noise():
    """P.372 at 30 MHz: 76.8 - 27.7 lg 30 = 35.88 dB in a city, 53.6 - 28.6 lg 30 = 11.36 dB in a quiet land.

    In a city at 915 MHz -5.23 dB, which makes 6 dB 6.31 dB.
    """
    np.testing.assert_allclose(way.with_man_made(f32(6.0), f32(30.0), "city"), 35.89, atol=5e-3)
    np.testing.assert_allclose(way.with_man_made(f32(6.0), f32(915.0), "city"), 6.314, atol=5e-3)
    np.testing.assert_allclose(way.with_man_made(f32(6.0), f32(915.0), "residential"), 6.121, atol=5e-3)
    np.testing.assert_allclose(way.with_man_made(f32(6.0), f32(30.0), "quiet_rural"), 12.465, atol=5e-3)
    np.testing.assert_array_equal(way.with_man_made(f32(6.0), f32(915.0), "none"), f32(6.0))


def test_bit_and_packet_error_rates():
    """FSK and BPSK at 0, 5 and 10 dB, and packets of 480 bits, by formulas of the C library in double precision."""
    per_bit = np.array([1.0, 10**0.5, 10.0])
    np.testing.assert_allclose(way.fsk_bit_error(f32(*per_bit)), [0.30326533, 0.10287033, 3.3689735e-3], rtol=2e-6)
    np.testing.assert_allclose(way.bpsk_bit_error(f32(*per_bit)), [0.07864960, 5.9538671e-3, 3.8721082e-6], rtol=3e-6)
    rates = np.array([1e-7, 1e-5, 1e-3, 9e-3, 2e-2, 0.3])
    expected = [-math.expm1(480 * math.log1p(-rate)) for rate in rates]
    np.testing.assert_allclose(way.packet_error(f32(*rates), 480.0), expected, rtol=3e-3, atol=2e-7)
    np.testing.assert_allclose(
        way.complementary_error(f32(0.0, 0.5, 1.0, 3.0)), [1.0, 0.47950012, 0.15729921, 2.2090497e-5], rtol=1e-6
    )


def test_a_threshold_is_one_half_there_and_ten_percent_above():
    found = way.threshold_error(f32(9.0, 10.0, 11.0986), jnp.float32(10.0), jnp.float32(0.5))
    np.testing.assert_allclose(found, [0.880797, 0.5, 0.1], rtol=1e-4)


@pytest.mark.parametrize(("size", "factor", "expected"), [(13, 9, 0.164864), (20, 7, 0.056576), (20, 12, 1.318912)])
def test_time_of_lora_on_the_air(size, factor, expected):
    """Of Semtech's calculator, at 125 kHz and 4/5."""
    assert way.lora_air_time(size, factor, 125e3) == pytest.approx(expected, abs=1e-9)


def field(seed, waves=64):
    stream = Key.root(seed).stream("/radio.field", jnp.arange(waves, dtype=jnp.uint32))
    return way.ShadowField.drawn(Draw(stream, jnp.int32(0), jnp.float32(0.0)))


@pytest.mark.long
def test_shadowing_is_a_field_of_both_ends():
    """Over 40 fields of 400 links: mean 0, variance 1, symmetric to the bit, correlation exp(-d/50 m).

    The tolerance of the mean over fields, 0.05, is more than three of its standard deviations (0.013 for links of one
    field that share their waves).
    """
    random = np.random.default_rng(1)
    one, other = (Vec3(*f32(*random.uniform(-2000.0, 2000.0, (3, 400)))) for _ in range(2))
    found = {d: [] for d in (0.0, 10.0, 50.0, 100.0)}
    means, squares = [], []
    for seed in range(40):
        waves = field(seed)
        still = np.asarray(waves.between(one, other, jnp.float32(50.0)))
        np.testing.assert_array_equal(still, waves.between(other, one, jnp.float32(50.0)))
        means.append(still.mean())
        squares.append((still**2).mean())
        for distance, products in found.items():
            moved = Vec3(one.x + distance, one.y, one.z)
            products.append((still * np.asarray(waves.between(moved, other, jnp.float32(50.0)))).mean())
    assert abs(np.mean(means)) < 0.05
    assert np.mean(squares) == pytest.approx(1.0, abs=0.05)
    for distance, products in found.items():
        assert np.mean(products) == pytest.approx(math.exp(-distance / 50.0), abs=0.05), distance


@pytest.mark.long
def test_walls_in_the_way_are_counted_and_a_building_once():
    """A box, a mast and an L-shaped building of two pieces in a row along north; beside and above them nothing."""
    box = BoxObstacle(f32(10), f32(12), f32(-5), f32(5), f32(-20), f32(0))
    mast = CylinderObstacle(f32(20), f32(0), f32(1), f32(-20), f32(0))
    shape = PrismObstacle.of([(30, -5), (30, 5), (40, 5), (40, 1), (35, 1), (35, -5)], -20.0)
    far = PrismObstacle.of([(50, -5), (50, 5), (55, 5), (55, -5)], -20.0)
    solids = Obstacles(box, mast, f32(0, 1), prisms_of([shape, far], [2, 3], 1.0))
    ends = [(60, 0, -10), (60, 2, -10), (45, 2, -10), (15, 0, -10), (0, 60, -10), (60, 0, -90), (11, 0, -10)]
    start = Vec3(*f32(*np.tile([[0.0], [0.0], [-10.0]], len(ends))))
    start = Vec3(start.x, start.y, f32(-10, -10, -10, -10, -10, -50, -10))
    found = walls_between(solids, start, Vec3(*f32(*np.transpose(ends))))
    # 60, 2: from the origin at east 0 to east 2, the line is at 0.7 to 1.3 east in the L, in both of its pieces.
    assert found.tolist() == [4, 4, 3, 1, 0, 0, 1]
