"""Numbers of the radio, one by one and by hand: channel, links, queues and propagation.

See docs/explanation/models/radio.md.
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

from qrsim.core.neighbours import Neighbours
from qrsim.core.noise import Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.radio.channel import Channel
from qrsim.models.radio.contracts import STREAMS, Exchange, Outbox, Surfaces
from qrsim.models.radio.links import Links, Outcome, error_rate, outcomes
from qrsim.models.radio.network import Counts, Network, NetworkState, Waiting
from qrsim.models.radio.parameters import Delay, Mac, Packet
from qrsim.models.radio.propagation import (
    LANDS,
    ShadowField,
    air_to_ground_loss,
    lora_air_time,
    noise_floor,
    packet_error,
)
from qrsim.models.radio.tables import Heard

QUIET = Delay(fixed=0.0, jitter=0.0)
# Of 60 bytes at 64 kbit/s [s].
AIR = 0.0075
NEAR = Packet(model="probability", range=1e6)  # type: ignore[arg-type]
# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0})


def f32(*values: float) -> Any:
    return jnp.asarray(values, jnp.float32)


class TestChannel:
    def test_the_last_slot_of_tdma_begins_a_slot_before_the_end(self) -> None:
        """19 of 20 slots of 10 ms, and 7.5 ms on the air."""
        channel = Channel(mac=Mac(type="tdma", period=0.2, slots=20), delay=QUIET)
        assert channel.latest == pytest.approx(0.19 + AIR, rel=1e-12)

    def test_the_longest_jitter_is_that_of_the_largest_normal(self) -> None:
        """Log-normal of sigma 0.5, and no normal is above 6.67: exp(3.335) = 28.078 medians."""
        assert Channel(delay=Delay(fixed=0.0, jitter=1.0)).latest == pytest.approx(AIR + 28.0784, rel=1e-5)

    @pytest.mark.parametrize(
        ("late", "periods"), [(0.5, 1), (1.0, 1), (1.0 + 0.9e-9, 1), (1.0 + 1.1e-9, 2), (1.5, 2), (2.0, 2)]
    )
    def test_packets_are_on_their_way_for_whole_periods(self, late: float, periods: int) -> None:
        """What is late by less than 1e-9 of a period is rounding."""
        channel = Channel(mac=Mac(period=0.2), delay=Delay(fixed=0.2 * late - AIR, jitter=0.0))
        assert channel.periods_on_the_way == periods

    def test_there_is_one_period_at_least(self) -> None:
        """Also for a byte at 1 Tbit/s, on the air for 4e-11 of a period."""
        assert Channel(rate_kbps=1e9, packet=Packet(bytes=1), delay=QUIET).periods_on_the_way == 1


@jit
def _fates(power: Any, begin: Any, sends: Any) -> Links:
    radio = cast(Network(mac=Mac(type="aloha", period=0.2), packet=NEAR), np.float32)
    none = [-1, -1]
    near = Neighbours(jnp.int32([[*none, 0], [*none, 1]]), jnp.full((2, 3), 1e4, jnp.float32), jnp.zeros(3, bool))
    each = jnp.zeros((2, 3)).at[:, 2].set(power)
    return outcomes(radio, near, each, begin, sends, jnp.full(3, -1), jnp.full((2, 3), 0.5))


def fates(power: tuple[float, float], begin: tuple[float, float], sends: tuple[bool, bool] = (True, True)) -> Links:
    """Return the links of vehicle 2 to vehicles 0 and 1, which send by aloha; by distance alone nothing is lost."""
    found = _fates(np.float32(power), np.float32([*begin, 0.1]), np.array([*sends, False]))  # type: ignore[arg-type]
    return jax.tree.map(np.asarray, found)


class TestLinks:
    def test_nobody_has_the_number_minus_one(self) -> None:
        links, heard = jit(lambda like: (Links.nothing(2, like), Heard.nothing(2, 4, like)))(np.zeros(3, np.float32))
        np.testing.assert_array_equal(links.sender, np.full((2, 3), -1))
        np.testing.assert_array_equal(heard.sender, np.full((2, 3), -1))
        links = fates((-60.0, -60.0), (0.0, 0.0), (True, False))
        assert links.sender.tolist() == [[-1, -1, 0], [-1, -1, -1]]

    @pytest.mark.parametrize(("overlap", "expected"), [(1.1e-6, Outcome.COLLISION), (0.9e-6, Outcome.HEARD)])
    def test_packets_may_touch_by_a_microsecond(self, overlap: float, expected: int) -> None:
        found = fates((-60.0, -60.0), (0.0, AIR - overlap)).outcome[:, 2]
        assert found.tolist() == [expected, expected]

    def test_a_power_below_1e_minus_30_milliwatts_is_nothing(self) -> None:
        """Of two packets of nearly the same power each disturbs the other: 1.1e-30 mW does, 0.9e-30 mW does not."""
        strong, weak = 10.0 * math.log10(1.1e-30), 10.0 * math.log10(0.9e-30)
        assert fates((strong, strong), (0.0, 0.0)).outcome[:, 2].tolist() == [Outcome.COLLISION] * 2
        assert fates((weak, weak), (0.0, 0.0)).outcome[:, 2].tolist() == [Outcome.HEARD] * 2

    def test_a_packet_alone_is_undisturbed_at_any_power(self) -> None:
        assert int(fates((-500.0, -60.0), (0.0, 0.0), (True, False)).outcome[0, 2]) == Outcome.HEARD

    def test_by_distance_alone_a_packet_is_lost_by_chance_within_reach_and_surely_beyond(self) -> None:
        radio = Channel(packet=Packet(model="probability", range=100.0, probability=0.7))  # type: ignore[arg-type]
        found = jit(partial(error_rate, radio))(np.zeros(2, np.float32), np.array([9e3, 1.1e4], np.float32))
        np.testing.assert_allclose(found, [0.3, 1.0], rtol=1e-6)


class Idle(Network):
    """A network that counts ticks of a period in the place of what it would send."""

    def _sent(self, state: Any, now: Exchange, ticks: int) -> Any:
        return jax.tree.map(lambda leaf: leaf + ticks, state)


def exchange_of(said: Any = None, due: int = 0, time_step: float = 0.02, count: int = 3) -> Exchange:
    places = Vec3(*(jnp.zeros(count) for _ in range(3)))
    surfaces = Surfaces(places, jnp.ones(count, bool))
    return Exchange(said, None, surfaces, np.arange(count, dtype=np.uint32), jnp.int32(7), jnp.int32(due), time_step)


def state_of(queue: int = 2, count: int = 3, size: int = 1) -> Any:
    """Return a state on the host that has nothing but an empty queue and counts."""
    zero, none = np.zeros(count, np.int32), np.full((queue, count), -1, np.int32)
    nothing: Any = None
    waiting: Any = Waiting(np.zeros((queue, size, count), np.float32), none, none)  # type: ignore[arg-type]
    counts: Any = Counts(*(zero,) * 8)  # type: ignore[arg-type]
    return NetworkState(nothing, nothing, waiting, nothing, nothing, counts, nothing)


class TestNetwork:
    @pytest.mark.parametrize(("time_step", "ticks"), [(0.2, 1), (0.1, 2), (0.5, 1)])
    def test_a_period_has_its_ticks_and_one_at_least(self, time_step: float, ticks: int) -> None:
        """At tick 2, which is due for all of them."""
        found: Any = Idle(mac=Mac(period=0.2)).exchange(jnp.int32(0), exchange_of(None, 2, time_step))
        assert int(found) == ticks

    def test_messages_wait_in_their_order_and_the_oldest_gives_way(self) -> None:
        """Vehicle 0 says 10, 20, 30 one after the other, vehicle 2 says 10 once, vehicle 1 nothing; two may wait."""
        radio, state = Idle(mac=Mac(period=0.2, queue=2)), jax.tree.map(jnp.asarray, state_of())

        @jit
        def say(state: Any, number: Any, speaks: Any) -> Any:
            said = Outbox(jnp.full((1, 3), number), speaks, jnp.int32([5, 6, -1]))
            return radio.exchange(state, exchange_of(said, 1))

        for number, speaks in ((10.0, [True, False, True]), (20.0, [True, False, False]), (30.0, [True, False, False])):
            state = say(state, np.float32(number), np.array(speaks))
        assert state.waiting.payload[:, 0].T.tolist() == [[20.0, 30.0], [0.0, 0.0], [10.0, 0.0]]
        assert state.waiting.to.T.tolist() == [[5, 5], [-1, -1], [-1, -1]]
        assert state.waiting.since.T.tolist() == [[7, 7], [-1, -1], [7, -1]]
        assert state.counts.lost_queue.tolist() == [1, 0, 0]

    def test_messages_from_outside_wait_alike(self) -> None:
        """Handed over on the host."""
        state, radio = state_of(), Network(mac=Mac(queue=2))
        for number, tick in ((10.0, 3), (20.0, 4), (30.0, 5)):
            state = radio.handed(state, 1, np.array([number]), 2, tick)
        assert state.waiting.payload[:, 0, 1].tolist() == [20.0, 30.0]
        assert state.waiting.since[:, 1].tolist() == [4, 5]
        assert state.waiting.to[:, 1].tolist() == [2, 2]
        assert state.counts.lost_queue.tolist() == [0, 1, 0]

    def test_a_packet_is_known_at_the_next_tick_at_the_earliest(self) -> None:
        """Times in ticks of 20 ms; what is late by less than a thousandth of one is not late."""
        radio: Any = cast(Network(rate_kbps=1e9, packet=Packet(bytes=1), delay=QUIET), np.float32)
        begin = np.array([0.0, 0.9995, 1.0005, 1.0011, 1.5, 2.0005])
        count = len(begin)

        @jit
        def arrives(begin: Any) -> Any:
            near = Neighbours(jnp.arange(count)[None], jnp.zeros((1, count)), jnp.zeros(count, bool))
            state = SimpleNamespace(keys=Key.root(1).streams(STREAMS))
            zero = jnp.zeros((1, count))
            links = Links(near.index, zero, zero, jnp.full((1, count), Outcome.HEARD))
            packets = (zero, jnp.zeros(count, jnp.int32), begin)
            return radio._arriving(state, near, links, packets, exchange_of(count=count), jnp.int32(0)).arrives[0]

        assert arrives(np.float32(0.02 * begin)).tolist() == [8, 8, 8, 9, 9, 9]


class TestPropagation:
    def test_lands_are_those_that_are_published(self) -> None:
        """a, b of Al-Hourani et al. 2014, and the excess losses with a line of sight and without [dB]."""
        assert LANDS == {
            "suburban": (4.88, 0.43, 0.1, 21.0),
            "urban": (9.61, 0.16, 1.0, 20.0),
            "dense_urban": (12.08, 0.11, 1.6, 23.0),
            "high_rise": (27.23, 0.08, 2.3, 34.0),
        }

    def test_free_space_over_land_and_the_noise_floor(self) -> None:
        """Straight above gardens 0.1 dB beside 20 log10(4 pi f d/c): 71.676 dB at 915 MHz over 100 m; -174 dBm/Hz."""

        @jit
        def found(squared: Any, frequency: Any, elevation: Any, figure: Any) -> Any:
            return air_to_ground_loss(squared, frequency, elevation, "suburban"), noise_floor(1e6, figure)

        loss, floor = found(*np.array([1e4, 915e6, math.pi / 2.0, 5.0], np.float32))
        np.testing.assert_allclose(loss, 71.676 + 0.1, atol=2e-3)
        np.testing.assert_allclose(floor, -174.0 + 60.0 + 5.0, atol=1e-4)

    def test_wave_numbers_are_normals_over_a_common_one(self) -> None:
        """Cauchy in six dimensions, in turns: over 2 pi, and over a thousandth at least; phases of number 16."""

        def words(tick: Any, index: int) -> tuple[Any, Any]:
            assert index == 16, "a seed means the same field as ever"
            return jnp.uint32([0, 1 << 30, 1 << 31]), None

        @jit
        def drawn(normals: Any) -> ShadowField:
            stream = SimpleNamespace(words=words)
            draw: Any = SimpleNamespace(normals=lambda count: normals, stream=stream, tick=0, like=normals[0])
            return ShadowField.drawn(draw)

        numbers = np.arange(1.0, 7.0)
        field = drawn(
            [*np.repeat(numbers, 3).reshape(6, 3).astype(np.float32), np.array([2.0, -0.5, 5e-4], np.float32)]
        )
        found = np.array([axis for end in (field.here, field.there) for axis in (end.x, end.y, end.z)])
        expected = numbers[:, None] / (2.0 * math.pi * np.array([2.0, 0.5, 1e-3]))
        np.testing.assert_allclose(found, expected, rtol=1e-6)
        np.testing.assert_allclose(field.phase, [0.0, 0.25, 0.5], atol=1e-6)

    def test_shadowing_is_a_sum_of_waves_from_both_ends(self) -> None:
        """Two waves of unit variance together: cos of 2 pi (k a + m b + phase), also of exchanged ends, over sqrt 2."""
        here = Vec3(f32(0.5, -1.0), f32(0.25, 0.0), f32(0.0, 1.5))
        there = Vec3(f32(-0.75, 0.5), f32(0.0, 2.0), f32(1.0, 0.0))
        phase = np.array([0.1, 0.7])
        one, other = (
            np.array([[3.0, 8.0], [5.0, 0.0], [-2.0, -4.0]]),
            np.array([[10.0, 1.0], [0.0, -6.0], [-7.0, -9.0]]),
        )
        field = ShadowField(here, there, f32(*phase))
        ends = [Vec3(*end.astype(np.float32)) for end in (one, other)]
        found = jit(ShadowField.between)(field, *ends, np.float32(20.0))
        k, m = np.array([[0.5, 0.25, 0.0], [-1.0, 0.0, 1.5]]), np.array([[-0.75, 0.0, 1.0], [0.5, 2.0, 0.0]])
        turns = [k @ a / 20.0 + m @ b / 20.0 + phase[:, None] for a, b in ((one, other), (other, one))]
        expected = np.cos(2.0 * math.pi * np.array(turns)).sum(axis=0)
        np.testing.assert_allclose(found, np.sum(expected, axis=0) / math.sqrt(2.0), atol=5e-6)

    def test_a_packet_of_one_bit_is_lost_as_often_as_the_bit(self) -> None:
        """In double precision: of a series to the third order below 0.01, 2e-7 is left; exact above."""
        with jax.enable_x64(True):
            rates = np.array([1e-9, 1e-3, 9e-3, 0.0101, 0.0119, 0.3])
            found = np.asarray(jit(partial(packet_error, bits=1.0))(rates)) / rates - 1.0
        np.testing.assert_array_less(np.abs(found[1:3]), 3e-7)
        np.testing.assert_array_less(np.abs(found[3:]), 1e-9)

    @pytest.mark.parametrize(
        ("size", "factor", "implicit", "symbols"),
        [
            # Symbols of 16.384 ms count as slow: ceil(160/(4 (11 - 2))) = 5 blocks of 5 symbols.
            (20, 11, False, 25),
            # (8 19 - 28 + 28 + 16)/28 = 6 blocks, and no more.
            (19, 7, False, 30),
            # Without a header (64 - 28 + 28 + 16 - 20)/28 = 2.14, so 3 blocks; with it 80/28, so 3 as well.
            (8, 7, True, 15),
            (8, 7, False, 15),
            # 84/28 = 3 blocks exactly, where a header would make 4.
            (11, 7, True, 15),
        ],
    )
    def test_blocks_of_lora(self, size: int, factor: int, implicit: bool, symbols: int) -> None:
        """AN1200.13: 8 + 4.25 symbols of preamble, 8, and blocks of 4/5, at 125 kHz."""
        expected = (20.25 + symbols) * 2**factor / 125e3
        assert lora_air_time(size, factor, 125e3, implicit_header=implicit) == pytest.approx(expected, rel=1e-12)
