"""Power and fate of single packets, by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.neighbours import Neighbours
from qrsim.core.noise import Key
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.models.radio.channel import FleetRadios
from qrsim.models.radio.contracts import STREAMS, Exchange, Surfaces
from qrsim.models.radio.links import Outcome, outcomes, powers
from qrsim.models.radio.network import Network
from qrsim.models.radio.parameters import Delay, Mac, Packet, PathLoss
from qrsim.models.radio.propagation import ShadowField
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle, Obstacles

NAN = np.float32(np.nan)


def f32(*values):
    return jnp.asarray(np.float32(values))


def near_of(index, squared):
    return Neighbours(jnp.int32(index), jnp.asarray(np.float32(squared)), jnp.zeros(len(index[0]), bool))


@pytest.mark.long
def test_power_falls_by_gains_distance_and_two_walls_at_most():
    """At 915 MHz 31.68 dB in the first metre and 44 dB over two decades; three boxes in the way take 2 x 20 dB."""
    three = BoxObstacle(
        f32(20, 40, 60), f32(22, 42, 62), f32(-5, -5, -5), f32(5, 5, 5), f32(-20, -20, -20), f32(0, 0, 0)
    )
    aside = CylinderObstacle(f32(0), f32(500), f32(1), f32(-20), f32(0))
    walls = Obstacles(three, aside, f32(0, 1, 2, 3))
    place = Vec3(f32(0, 100), f32(0, 0), f32(-10, -10))
    near = near_of([[1, 0]], [[1e4, 1e4]])
    zero = f32(0)
    still = ShadowField(Vec3(zero, zero, zero), Vec3(zero, zero, zero), zero)

    def received(radio, obstacles):
        return np.asarray(powers(radio, still, near, Surfaces(place, jnp.ones(2, bool), obstacles)))[0]

    radio = cast(Network(path_loss=PathLoss(shadowing_db=0.0, waves=1), gain_db=2.0), np.float32)
    np.testing.assert_allclose(received(radio, None), [-51.68, -51.68], atol=5e-3)
    own = FleetRadios(f32(10.0, NAN), f32(3.0, 1.5), f32(NAN, NAN), jnp.ones(2, bool))
    np.testing.assert_allclose(received(replace(radio, own=own), walls), [-91.18, -101.18], atol=5e-3)


@pytest.mark.parametrize(
    ("land", "far", "lost"),
    [
        # tan 30 deg = 0.5774: a chance of a line of sight of 0.7307 by hand, and 20 - 19 * 0.7307 = 6.12 dB.
        ("urban", 100.0 / np.tan(np.radians(30.0)), 6.12),
        # 15 deg: 0.1980, so 16.24 dB.
        ("urban", 100.0 / np.tan(np.radians(15.0)), 16.24),
        # 15 deg over gardens: 4.88 exp(-0.43 10.12) = 0.0629, a chance of 0.9408, so 21 - 20.9 * 0.9408 dB.
        ("suburban", 100.0 / np.tan(np.radians(15.0)), 1.336),
        # Right above there is nothing in the way of gardens but their 0.1 dB.
        ("suburban", 0.0, 0.1),
        # 30 deg: 12.08 exp(-0.11 17.92) = 1.6827, a chance of 0.3728, so 23 - 21.4 * 0.3728 dB.
        ("dense_urban", 100.0 / np.tan(np.radians(30.0)), 15.023),
        # Right above: 27.23 exp(-0.08 (90 - 27.23)) = 0.1797, so a chance of 0.8477 and 34 - 31.7 * 0.8477 dB.
        ("high_rise", 0.0, 7.13),
    ],
)
def test_between_ground_and_air_there_is_the_land(land, far, lost):
    """Free space and what buildings take by the elevation; links of two in the air, or on the ground, are as usual."""
    way = PathLoss(shadowing_db=0.0, waves=1, ground="none", air_to_ground=land)
    radio = cast(Network(path_loss=way), np.float32)
    place = Vec3(f32(0, far, 0), f32(0, 0, 300), f32(-4, -104, -3))
    length = np.hypot(far, 100.0)
    near = near_of([[1, 0, 0]], [[length**2, length**2, 300.0**2 + 1.0]])
    zero = f32(0)
    still = ShadowField(Vec3(zero, zero, zero), Vec3(zero, zero, zero), zero)

    def received(*height):
        return np.asarray(powers(radio, still, near, Surfaces(place, jnp.ones(3, bool), height=f32(*height))))[0]

    # 20 dBm at 915 MHz, 31.676 dB in the first metre; on the ground is who is no higher than 5 m above it.
    found, over = received(4.9, 104.0, 3.0), 20.0 - 31.676 - 20.0 * np.log10(length) - lost
    np.testing.assert_allclose(found[:2], over, atol=0.01)
    assert found[2] == pytest.approx(20.0 - 31.676 - 22.0 * np.log10(300.0), abs=0.01)
    np.testing.assert_allclose(received(5.1, 104.0, 3.0)[:2], 20.0 - 31.676 - 22.0 * np.log10(length), atol=0.01)
    assert not Network(path_loss=PathLoss(ground="none")).asks_height


@pytest.mark.parametrize(
    ("ground", "heights", "distance", "lost"),
    [
        # At 915 MHz 31.676 dB in the first metre and 22 dB a decade; mirrored 40 lg d - 20 lg(h1 h2).
        ("two_ray", (10.0, 10.0), 1_000.0, 31.676 + 66.0),
        ("two_ray", (10.0, 10.0), 20_000.0, 172.041 - 40.0),
        ("two_ray", (100.0, 100.0), 20_000.0, 31.676 + 94.623),
        ("none", (10.0, 10.0), 20_000.0, 31.676 + 94.623),
        # On the ground an antenna is as if 0.638 x 0.3276 = 0.209 m high: 26.80 dB of both.
        ("two_ray", (0.0, 0.0), 1_000.0, 120.0 + 27.19),
    ],
)
def test_the_ground_mirrors(ground, heights, distance, lost):
    way = PathLoss(shadowing_db=0.0, waves=1, ground=ground)
    radio = cast(Network(path_loss=way), np.float32)
    place = Vec3(f32(0, distance), f32(0, 0), f32(-heights[0], -heights[1]))
    near, zero = near_of([[1, 0]], [[distance**2, distance**2]]), f32(0)
    still = ShadowField(Vec3(zero, zero, zero), Vec3(zero, zero, zero), zero)
    found = powers(radio, still, near, Surfaces(place, jnp.ones(2, bool), height=f32(*heights)))
    np.testing.assert_allclose(found[0], 20.0 - lost, atol=0.02)
    assert radio.asks_height == (ground == "two_ray")


AIR, PERIOD = 0.0075, 0.2
MANY = 20_000


def fate(kind, packet, power, begin, chance=(0.5, 0.5), speaks=False):
    """Return what becomes at vehicle 2 of packets of vehicles 0 and 1, of 7.5 ms each."""
    radio = cast(Network(mac=Mac(type=kind, period=PERIOD), packet=packet), np.float32)
    assert radio.air_time == AIR
    near = near_of([[-1, -1, 0], [-1, -1, 1]], np.full((2, 3), 1e4))

    def at_the_last(values):
        return jnp.zeros((2, 3)).at[:, 2].set(f32(*values))

    links = outcomes(
        radio,
        near,
        at_the_last(power),
        f32(*begin),
        jnp.array([True, True, speaks]),
        jnp.int32([-1, -1, -1]),
        at_the_last(chance),
    )
    return links.outcome[:, 2].tolist()


CLEAR = Packet(model="probability", range=1e6)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "power", "begin", "expected"),
    [
        # 6 dB above the other is enough.
        ("aloha", (-60.0, -66.5), (0.0, 0.0), [Outcome.HEARD, Outcome.COLLISION]),
        ("aloha", (-60.0, -65.5), (0.0, 0.0), [Outcome.COLLISION, Outcome.COLLISION]),
        # They overlap by half a millisecond, and do not.
        ("aloha", (-60.0, -60.0), (0.0, 0.007), [Outcome.COLLISION, Outcome.COLLISION]),
        ("aloha", (-60.0, -60.0), (0.0, 0.008), [Outcome.HEARD, Outcome.HEARD]),
        # What goes on at the end of a period disturbs the next, but where all is over by its end.
        ("aloha", (-60.0, -60.0), (0.001, 0.199), [Outcome.COLLISION, Outcome.COLLISION]),
        ("csma", (-60.0, -60.0), (0.001, 0.199), [Outcome.HEARD, Outcome.HEARD]),
        ("ideal", (-60.0, -60.0), (0.0, 0.0), [Outcome.HEARD, Outcome.HEARD]),
    ],
)
def test_packets_at_once_collide_unless_one_is_stronger(kind, power, begin, expected):
    assert fate(kind, CLEAR, power, (*begin, 0.1)) == expected


def test_who_sends_hears_nothing_meanwhile():
    assert fate("aloha", CLEAR, (-60.0, -60.0), (0.05, 0.1, 0.104), speaks=True) == [Outcome.HEARD, Outcome.COLLISION]


def test_what_survives_a_weaker_one_has_it_as_noise():
    """10 dB above the other, and noise at -114 dBm: a threshold of 10 dB loses half, to the other."""
    packet = Packet(model="threshold", snr50_db=10.0, width_db=0.5)
    for chance, expected in ((0.45, Outcome.COLLISION), (0.55, Outcome.HEARD)):
        assert fate("aloha", packet, (-60.0, -70.0), (0.0, 0.0, 0.1), (chance, 0.5))[0] == expected


@pytest.mark.parametrize(("loss", "expected"), [(0.85, Outcome.NOISE), (0.95, Outcome.WEAK)])
def test_a_link_that_loses_more_than_nine_tenths_is_too_weak(loss, expected):
    packet = Packet(model="probability", range=1e6, probability=1.0 - loss)
    assert fate("ideal", packet, (-60.0, -60.0), (0.0, 0.0, 0.1)) == [expected, expected]


def late(delay, distance):
    """Return how long after they are sent packets are known at each of MANY vehicles [s]."""
    radio = cast(Network(delay=delay), np.float32)
    ids = np.arange(MANY, dtype=np.uint32)
    near = near_of(np.zeros((1, MANY)), np.full((1, MANY), distance**2))
    now = Exchange(None, None, None, ids, jnp.int32(0), jnp.int32(0), 0.02)
    return np.asarray(radio._late(Key.root(1).streams(STREAMS), near, jnp.zeros((1, MANY)), now, jnp.int32(0)))[0]


def test_a_packet_is_known_after_air_way_and_processing():
    """7.5 ms on the air, 3 ms over 900 km, 40 ms at both ends."""
    np.testing.assert_allclose(late(Delay(fixed=0.04, jitter=0.0), 9e5), 0.0505021, rtol=1e-5)


def test_jitter_is_log_normal():
    """Of 20 000, seed 1: median 1 s and sigma 0.5 of the logarithm, each within four standard deviations."""
    found = np.log(late(Delay(fixed=0.0, jitter=1.0), 0.0) - AIR)
    assert abs(np.median(found)) < 4.0 * 1.2533 * 0.5 / MANY**0.5
    assert found.std() == pytest.approx(0.5, abs=4.0 * 0.5 / (2.0 * MANY) ** 0.5)
