"""Who hears what and when, by hand and by laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.neighbours import Neighbours
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.models.radio.contracts import STREAMS, Exchange, Outbox, Surfaces
from qrsim.models.radio.links import Outcome, outcomes
from qrsim.models.radio.network import Network
from qrsim.models.radio.parameters import Delay, InboxSize, Mac, Packet, PathLoss

STEP = 0.02
CLEAR = PathLoss(shadowing_db=0.0, waves=2)
QUIET = Delay(fixed=0.0, jitter=0.0)


def network(**parts):
    usual = {"path_loss": CLEAR, "delay": QUIET, "inbox": InboxSize(size=2, candidates=2)}
    return cast(Network(**{**usual, **parts}), np.float32)


@pytest.mark.parametrize(
    ("preset", "channel", "law", "air_ms"),
    [
        ("sik_915", (915.0, 20.0, 250.0, 64.0, 6.0), ("fsk", None), 7.5),
        ("xbee_pro_900", (915.0, 17.0, 300.0, 156.0, 6.0), ("threshold", 12.13), 3.0769),
        ("wifi_2g4", (2437.0, 20.0, 20_000.0, 6000.0, 7.0), ("threshold", 10.89), 0.1),
        # (8 + 4.25 + 8 + 50) symbols of 1.024 ms and (8 + 4.25 + 8 + 35) of 32.768 ms.
        ("lora_sf7", (868.0, 14.0, 125.0, 5.47, 6.0), ("threshold", -8.6), 71.936),
        ("lora_sf12", (868.0, 14.0, 125.0, 0.293, 6.0), ("threshold", -21.1), 1810.432),
    ],
)
def test_a_preset_named_in_python_is_that_of_its_sheet(preset, channel, law, air_ms):
    """MHz, dBm, kHz, kbit/s, dB; law of the loss with its ratio [dB]; time of a packet on the air.

    See docs/explanation/models/radio.md.
    """
    radio = Network(preset=preset)
    assert channel == (
        radio.frequency_mhz,
        radio.power_dbm,
        radio.bandwidth_khz,
        radio.rate_kbps,
        radio.noise_figure_db,
    )
    assert radio.packet.model == law[0]
    assert law[1] is None or radio.packet.snr50_db == law[1]
    assert 1e3 * radio.air_time == pytest.approx(air_ms, rel=1e-4)


def test_what_is_not_of_a_preset_has_its_default():
    """Numbers of docs/explanation/models/radio.md.

    A part that is given counts as a whole, and others are still those of the preset.
    """
    radio = Network(preset="lora_sf12", packet=Packet(bytes=40))
    assert (radio.packet.model, radio.packet.spreading_factor, radio.packet.bytes) == ("fsk", 0, 40)
    assert (radio.mac.period, radio.inbox.forget, radio.frequency_mhz) == (2.0, 20.0, 868.0)
    usual = Network()
    assert vars(usual.path_loss) == {
        "exponent": 2.2,
        "shadowing_db": 3.0,
        "correlation_distance": 50.0,
        "blocked_db": 20.0,
        "waves": 32,
        "ground": "two_ray",
        "air_to_ground": "none",
        "ground_height": 5.0,
    }
    assert (usual.packet.capture_db, usual.packet.width_db, usual.delay.fixed, usual.delay.jitter) == (
        6.0,
        0.5,
        0.005,
        0.002,
    )
    assert (usual.inbox.reach, usual.inbox.candidates, usual.inbox.forget) == (300.0, 24, 2.0)


class Air:
    """A network and its vehicles, from tick to tick."""

    def __init__(self, radio, positions, seed=1, ids=None):
        points = np.asarray(positions, np.float32)
        self.radio, self.position = radio, Vec3(*(jnp.asarray(points[:, i]) for i in range(3)))
        self.n, self.tick = len(points), 0
        self.ids = np.arange(self.n, dtype=np.uint32) if ids is None else ids
        key = Key.root(seed)
        waves = Draw(
            key.stream("/radio.field", jnp.arange(radio.field_ids, dtype=jnp.uint32)), jnp.int32(0), jnp.float32(0)
        )
        self.state = radio.init(waves, key.streams(STREAMS), self.position.x)
        self._step = jax.jit(self._exchange)

    def _exchange(self, state, said, beacons, tick):
        surfaces = Surfaces(self.position, jnp.ones(self.n, bool))
        return self.radio.exchange(state, Exchange(said, beacons, surfaces, self.ids, tick, tick, STEP))

    def beacons(self):
        numbers = jnp.arange(self.n * self.radio.size, dtype=jnp.float32).reshape(self.radio.size, self.n)
        return Outbox(numbers, jnp.ones(self.n, bool), jnp.full(self.n, -1, jnp.int32))

    def fly(self, ticks, said=None, beacons=True):
        for _ in range(ticks):
            self.state = self._step(self.state, said, self.beacons() if beacons else None, jnp.int32(self.tick))
            self.tick += 1
        return self

    def inbox(self):
        state = jax.tree.map(np.asarray, self.state)
        return self.radio.received(state, np.int32(self.tick), STEP)


def counts(air):
    return {name: np.asarray(value).tolist() for name, value in vars(air.state.counts).items()}


@pytest.mark.long
def test_what_is_sent_is_heard_by_those_near_and_its_age_is_exact():
    """Two 100 m apart and one 1 km away; 60 bytes at 64 kb/s are 7.5 ms, so known at the next tick and no sooner."""
    air = Air(network(), [(0, 0, -50), (100, 0, -50), (1000, 0, -50)])
    assert not air.inbox().mask.any()
    heard = air.fly(1).inbox()
    assert heard.sender[:, 0].tolist() == [1, 0, -1]
    assert heard.payload[0, 0].tolist() == [1.0, 4.0, 7.0, 10.0, 13.0, 16.0]
    np.testing.assert_allclose(heard.age[:2, 0], 0.02, rtol=1e-6)
    # Until the next period it grows older.
    np.testing.assert_allclose(air.fly(9).inbox().age[:2, 0], 0.2, rtol=1e-6)
    np.testing.assert_allclose(air.fly(1).inbox().age[:2, 0], 0.02, rtol=1e-6)
    # 20 dBm - 31.68 dB - 44 dB.
    np.testing.assert_allclose(heard.rssi[:2, 0], -55.68, atol=0.01)
    assert counts(air)["sent"] == [2, 2, 2]


@pytest.mark.long
def test_a_packet_that_takes_long_is_not_known_before():
    """7.5 ms on the air and 45 ms of processing are three ticks; who says nothing is forgotten after half a second."""
    air = Air(
        network(delay=Delay(fixed=0.045, jitter=0.0), inbox=InboxSize(size=1, candidates=1, forget=0.5)),
        [(0, 0, 0), (9, 0, 0)],
    )
    assert [bool(air.fly(1).inbox().mask.any()) for _ in range(4)] == [False, False, True, True]
    air.fly(7, beacons=True)
    last = [bool(air.fly(1, beacons=False).inbox().mask.any()) for _ in range(30)]
    assert last == [True] * 24 + [False] * 6


@pytest.mark.long
def test_one_receiver_alone_hears_what_is_meant_for_it():
    """Vehicle 0 to 2, 2 to all, 1 nothing; ids of nobody are heard by nobody."""
    air = Air(network(beacon=False), [(0, 0, 0), (10, 0, 0), (20, 0, 0)])
    said = Outbox(jnp.ones((6, 3)), jnp.array([True, False, True]), jnp.int32([2, -1, -1]))
    heard = air.fly(1, said, beacons=False).inbox()
    assert heard.sender[:, :2].tolist() == [[2, -1], [2, -1], [0, -1]]
    assert counts(air)["heard"] == [1, 1, 1]


@pytest.mark.long
def test_a_queue_keeps_the_newest_and_sends_the_oldest_of_them():
    """Two places and a message at each of ten ticks: number 8 and 9 are left, and 8 goes on the air at tick 10."""
    radio = network(beacon=False, mac=Mac(queue=2))
    air = Air(radio, [(0, 0, 0), (10, 0, 0)])
    heard = []
    for tick in range(21):
        said = Outbox(jnp.full((6, 2), float(tick)), jnp.array([tick < 10, False]), jnp.int32([-1, -1]))
        heard.append(air.fly(1, said, beacons=False).inbox().payload[1, 0, 0])
    # Number 0 was sent at once.
    assert heard[:10] == [0.0] * 10
    assert heard[10:] == [8.0] * 10 + [9.0]
    assert counts(air)["lost_queue"] == [7, 0]
    assert counts(air)["sent"] == [3, 0]


@pytest.mark.long
def test_slots_do_not_collide_and_carry_what_they_can():
    """20 vehicles in 20 slots, all in range: each hears the 19 others in every period; in one slot nobody hears any."""
    places = np.random.default_rng(2).uniform(0.0, 50.0, (20, 3))
    wide = InboxSize(size=19, candidates=19)
    air = Air(network(mac=Mac(type="tdma", slots=20), inbox=wide), places).fly(31)
    assert counts(air)["heard"] == [4 * 19] * 20
    assert counts(air)["lost_collision"] == [0] * 20
    same = Air(network(mac=Mac(type="tdma", slots=1), inbox=wide, packet=Packet(capture_db=300.0)), places).fly(1)
    assert counts(same)["heard"] == [0] * 20


@pytest.mark.nightly
@pytest.mark.parametrize("load", [0.1, 0.5])
def test_pure_aloha_is_heard_as_the_law_says(load):
    """Success exp(-2 G) of Abramson 1970, for packets from 24 others to a receiver that is not one of them.

    With n senders of air time a in a period T, each other one disturbs with chance 2 a/T, so that the expected part is
    (1 - 2 a/T)^(n-1), which is exp(-2 G) within 2 % here; 2 % again are four standard deviations of 2e5 packets.
    """
    n, period = 25, 0.2
    seconds = load * period / (n - 1)
    rate = 8 * 60 / seconds / 1000.0
    radio = network(
        rate_kbps=rate,
        mac=Mac(type="aloha", period=period),
        inbox=InboxSize(size=1, candidates=n),
        beacon=False,
        packet=Packet(model="probability", range=1e6, capture_db=300.0),
    )
    sends = jnp.arange(n + 1) < n
    said = Outbox(jnp.zeros((6, n + 1)), sends, jnp.full(n + 1, n, jnp.int32))
    air = Air(radio, np.column_stack([np.arange(n + 1) * 1.0, np.zeros((n + 1, 2))]))
    many = jax.jit(
        lambda state, tick: jax.lax.fori_loop(
            0, 8000, lambda i, now: air._exchange(now, said, None, tick + i * 10), state
        )
    )
    found = many(air.state, jnp.int32(0)).counts
    part = float(found.heard[n] / found.sent[:n].sum())
    assert part == pytest.approx((1.0 - 2.0 * load / (n - 1)) ** (n - 1), rel=0.02)
    assert part == pytest.approx(np.exp(-2.0 * load), rel=0.04)


@pytest.mark.long
def test_who_listens_first_does_not_collide_with_whom_it_hears():
    """12 in range of each other and 60 % of a period's time asked for: no collision; what finds no time waits."""
    places = np.random.default_rng(3).uniform(0.0, 30.0, (12, 3))
    radio = network(mac=Mac(type="csma", period=0.16), inbox=InboxSize(size=11, candidates=11))
    air = Air(radio, places).fly(81)
    found = {name: np.sum(value) for name, value in counts(air).items()}
    assert found["lost_collision"] == 0
    assert found["heard"] == 11 * found["sent"]
    assert found["sent"] + found["deferred"] == 12 * 11
    assert 0 < found["deferred"] < 0.3 * 12 * 11


@pytest.mark.parametrize(("sense", "collide"), [("packet", True), ("noise", False)])
def test_who_is_hidden_from_another_sends_at_the_same_time(sense, collide):
    """Of three in a row 500 m apart the outer ones are 5 dB above each other's noise, too weak for their packets."""
    mac = Mac(type="csma", sense=sense)
    packet = Packet(model="threshold", snr50_db=10.0)
    radio = network(
        power_dbm=-13.4, rate_kbps=8.0, mac=mac, packet=packet, inbox=InboxSize(size=2, candidates=2, reach=5000.0)
    )
    air = Air(radio, [(-500.0, 0, 0), (0, 0, 0), (500.0, 0, 0)])
    np.testing.assert_array_equal(counts(air.fly(150))["sent"] > np.full(3, 0), True)
    assert (counts(air)["lost_collision"][1] > 2) == collide


@pytest.mark.long
def test_the_chance_of_loss_at_five_distances_is_that_of_the_law():
    """1e5 packets at each: within 3 standard deviations of 1 - (1 - exp(-SNR B/2R)/2)^480, in double precision."""
    radio, many = network(man_made="none"), 100_000
    keys, ids = Key.root(3).streams(STREAMS), np.arange(many, dtype=np.uint32)
    for number, distance in enumerate((13_000.0, 15_000.0, 17_000.0, 19_000.0, 22_000.0)):
        loss = 20.0 * np.log10(4.0 * np.pi * 915e6 / 299792458.0) + 22.0 * np.log10(distance)
        ratio = 10.0 ** ((20.0 - loss + 174.0 - 10.0 * np.log10(250e3) - 6.0) / 10.0)
        law = 1.0 - (1.0 - 0.5 * np.exp(-ratio * 250.0 / 64.0 / 2.0)) ** 480
        near = Neighbours(
            jnp.zeros((1, many), jnp.int32).at[0, 0].set(-1),
            jnp.full((1, many), np.float32(distance**2)),
            jnp.zeros(many, bool),
        )
        zero, power = jnp.zeros(many), jnp.full((1, many), np.float32(20.0 - loss))
        chance = radio._chance(keys, near, ids, jnp.int32(number))
        links = outcomes(radio, near, power, zero, zero == 0, jnp.full(many, -1), chance)
        heard = int((links.outcome == Outcome.HEARD).sum())
        lost = 1.0 - heard / (many - 1)
        assert abs(lost - law) < 3.0 * np.sqrt(law * (1.0 - law) / many) + 2e-5, (distance, law, lost)


@pytest.mark.long
def test_a_vehicle_out_of_reach_changes_no_inbox():
    """Nor does its place in the numbering: draws belong to ids."""
    places = np.random.default_rng(4).uniform(0.0, 25_000.0, (9, 3)) * [1.0, 1.0, 0.0]
    far = {"inbox": InboxSize(size=4, reach=30_000.0, candidates=8), "path_loss": PathLoss(waves=8)}
    ids = np.arange(100, 109, dtype=np.uint32)
    fewer = Air(network(**far), places, ids=ids).fly(61)
    alone = fewer.inbox()
    more = np.vstack([[60_000.0, 0.0, 0.0], places])
    all_of_them = Air(network(**far), more, ids=np.concatenate([np.uint32([7]), ids])).fly(61)
    among = all_of_them.inbox()
    for name, numbers in counts(fewer).items():
        assert counts(all_of_them)[name][1:] == numbers
    assert sum(counts(fewer)["lost_noise"]) > 10
    np.testing.assert_array_equal(np.where(among.sender[1:] >= 0, among.sender[1:] - 1, -1), alone.sender)
    np.testing.assert_allclose(among.rssi[1:], alone.rssi, rtol=1e-5)


@pytest.mark.long
def test_many_worlds_hear_as_each_alone():
    places = np.random.default_rng(5).uniform(0.0, 25_000.0, (6, 3)) * [1.0, 1.0, 0.0]
    airs = [Air(network(inbox=InboxSize(size=3, candidates=5, reach=40_000.0)), places, seed) for seed in (1, 2)]
    states = jax.tree.map(lambda a, b: jnp.stack([a, b]), *(air.state for air in airs))
    both = jax.jit(jax.vmap(airs[0]._exchange, in_axes=(0, None, None, None)))
    for tick in range(21):
        states = both(states, None, airs[0].beacons(), jnp.int32(tick))
    for number, air in enumerate(airs):
        air.fly(21)
        for mine, theirs in zip(jax.tree.leaves(air.state.counts), jax.tree.leaves(states.counts), strict=True):
            np.testing.assert_array_equal(mine, theirs[number])
    assert counts(airs[0]) != counts(airs[1])


@pytest.mark.long
def test_a_weaker_radio_and_none_at_all():
    """A fleet's own power is 10 dB lower at whoever hears it, and what is silent is deaf too."""
    from qrsim.models.radio.channel import FleetRadios

    nan = np.float32(np.nan)
    own = FleetRadios(jnp.asarray([10.0, nan, nan]), jnp.full(3, nan), jnp.full(3, nan), jnp.array([True, True, False]))
    air = Air(replace(network(), own=own), [(0, 0, 0), (100, 0, 0), (50, 0, 0)])
    air._step = lambda state, said, beacons, tick: air.radio.exchange(
        state, Exchange(said, beacons, Surfaces(air.position, own.works), air.ids, tick, tick, STEP)
    )
    heard = air.fly(1).inbox()
    assert heard.sender.tolist() == [[1, -1], [0, -1], [-1, -1]]
    np.testing.assert_allclose([heard.rssi[0, 0], heard.rssi[1, 0]], [-55.68, -65.68], atol=0.01)
