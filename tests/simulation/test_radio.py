"""Messages as users say and hear them: by a simulation, by policies, in logs and metrics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.errors import RadioWarning, ScenarioError, UsageError
from qrsim.simulation.blocks import LateRadio

RADIO = {"preset": "sik_915", "beacon": False, "inbox": {"size": 2, "candidates": 2}, "path_loss": {"waves": 2}}


def scenario(radio=RADIO, **parts):
    places = [(0.0, 0.0, -20.0), (20.0, 0.0, -20.0), (40.0, 0.0, -20.0)]
    return qrsim.make_scenario(places, radio=radio, duration=1.0, **parts)


@pytest.fixture(scope="module")
def simulation():
    return qrsim.Simulation(scenario().world(), seed=4)


def test_a_message_reaches_who_it_is_for_and_survives_saving(simulation):
    simulation.reset()
    simulation.send("vehicles_0", [1.0, 2.0])
    simulation.send(1, [3.0], to="vehicles_2")
    held = simulation.save()
    simulation.advance(ticks=1)
    assert simulation.inbox("vehicles_0") == []
    (one,) = simulation.inbox(1)
    assert (one.sender, one.sent, one.received) == ("vehicles_0", 0.0, 0.02)
    assert one.payload.tolist() == [1.0, 2.0, 0.0, 0.0, 0.0, 0.0]
    # 60 bytes at 64 kb/s are 7.5 ms; 20 dBm - 31.68 dB - 28.62 dB, and shadowing of 3 dB.
    assert one.rssi == pytest.approx(-40.3, abs=12.0)
    assert [message.sender for message in simulation.inbox(2)] == ["vehicles_1", "vehicles_0"]
    later = simulation.state
    simulation.load(held)
    simulation.advance(ticks=1)
    for mine, theirs in zip(jax.tree.leaves(simulation.state), jax.tree.leaves(later), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.long
def test_what_is_said_with_a_command_is_heard(simulation):
    simulation.reset()
    words = np.arange(18.0).reshape(3, 6)
    reading = simulation.step(qrsim.Say(words, send=[True, False, False], to=[1, -1, -1]))
    assert reading.inbox.sender.tolist() == [[-1, -1], [0, -1], [-1, -1]]
    assert reading.inbox.payload[1, 0].tolist() == words[0].tolist()
    assert reading.of("vehicles_1").inbox.age.tolist()[0][0] == pytest.approx(0.02)
    assert simulation.compiled_by == ("llvm", "")


def test_bad_messages_are_refused_in_one_line(simulation):
    simulation.reset()
    words = np.zeros((3, 6))
    with pytest.raises(UsageError, match=r"7 numbers are more than a message has, 6"):
        simulation.send(0, [0.0] * 7)
    with pytest.raises(UsageError, match=r"send: to: no vehicle is called 'vehicle_1'; did you mean 'vehicles_1'"):
        simulation.send(0, [0.0], to="vehicle_1")
    with pytest.raises(UsageError, match=r"inbox: vehicle: 3 is nobody; allowed: 0 to 2"):
        simulation.inbox(3)
    with pytest.raises(UsageError, match=r"say: to: 5 is nobody; allowed: 0 to 2, or -1 for all"):
        simulation.step(qrsim.Say(words, to=5))
    with pytest.raises(UsageError, match=r"expected shape \(3, 6\), found \(2, 6\)"):
        simulation.step(qrsim.Say(words[:2]))
    silent = qrsim.load("free_flight")
    for call in (lambda: silent.send(0, [0.0]), lambda: silent.inbox(0), lambda: silent.reset().inbox):
        silent.reset()
        with pytest.raises(UsageError, match=r"the scenario has no world.radio"):
            call()


@pytest.mark.long
def test_a_key_is_another_one_at_every_tick_and_in_every_episode(simulation):
    """And numbers of the one vehicle are not those of the other; no reading is needed for them."""
    first = simulation.reset(seed=4)
    keys = [first.key, simulation.step().key, simulation.reset(seed=5).key]
    assert len({tuple(key.tolist()) for key in keys}) == 3
    assert simulation.reset(seed=4).key.tolist() == keys[0].tolist()
    drawn = simulation.reading.normals(4)
    assert drawn.shape == (3, 4)
    assert len(np.unique(drawn)) == 12
    assert np.isfinite(jax.random.normal(keys[0], (3,))).all()
    assert np.random.default_rng(keys[0]).uniform() >= 0.0


@pytest.mark.parametrize(
    ("radio", "line"),
    [
        ("sik_916", "world.radio.preset: 'sik_916' is not allowed; .* did you mean 'sik_915'"),
        (
            {"mac": {"type": "tdma", "slots": 40}},
            "a slot of world.radio.mac is 0.005 s, but a packet of 60 bytes is 0.0075 s on the air; allowed: up to 26",
        ),
        ({"size": 20}, "20 numbers are 80 bytes, more than a packet of 60 bytes; allowed: up to 15 numbers"),
        ({"preset": "lora_sf12", "mac": {"period": 0.2}}, "on the air; allowed: a period of at least 1.82 s"),
        ({"mac": {"period": 0.03}}, "world.radio.mac.period: 0.03 s is not a multiple of the time step 0.02 s"),
    ],
)
def test_a_radio_that_cannot_be_is_refused_in_one_line(radio, line):
    with pytest.raises(ScenarioError, match=line) as caught:
        qrsim.load_scenario({"name": "x", "extends": "free_flight", "world": {"radio": radio}})
    assert len(str(caught.value).splitlines()) == 2


def test_the_state_of_radios_is_fetched_once_a_tick_and_only_where_somebody_listens():
    fetched = []

    def fetch():
        fetched.append(1)
        return {"sender": np.array([[3, 4], [5, 6]])}

    deaf, listening = LateRadio(fetch), LateRadio(fetch)
    assert [listening.of(world)["sender"].tolist() for world in (1, 0, 1)] == [[5, 6], [3, 4], [5, 6]]
    assert len(fetched) == 1
    deaf.over = listening.over = True
    assert listening.of(0)["sender"].tolist() == [3, 4]
    with pytest.raises(UsageError, match=r"inbox: this reading is of an earlier tick.* keep what you need"):
        deaf.of(0)
    assert len(fetched) == 1


@pytest.mark.long
@pytest.mark.parametrize("listens", [False, True])
def test_lock_step_leaves_radios_alone_where_its_policy_does_not_listen(listens, monkeypatch):
    """1 s of 0.02 s: asked 50 times, in two worlds."""
    looked = []
    whole = LateRadio.of
    monkeypatch.setattr(LateRadio, "of", lambda self, world: looked.append(world) or whole(self, world))

    def policy(reading):
        looks = reading.inbox.mask.any() if listens else False
        return qrsim.VelocitySetpoint.of(np.full((3, 3), 0.01 * looks), 0.0)

    assert qrsim.rollout(scenario(controller="velocity"), policy, worlds=2).metrics["radio_sent"].sum() == 0
    assert looked == ([0, 1] * 50 if listens else [])


@pytest.mark.long
def test_policies_of_both_kinds_hear_the_same():
    """Each says how far north it is, and flies north at the mean of what it has heard; NumPy as compiled."""

    def plain(reading):
        north = reading.gnss.position_ned[:, :1]
        heard = np.where(reading.inbox.mask, reading.inbox.payload[:, :, 0], 0.0).mean(axis=1)
        return qrsim.Say(north, qrsim.VelocitySetpoint.of(np.stack([0.01 * heard, 0 * heard, 0 * heard], 1), 0.0))

    @jax.jit
    def compiled(reading):
        north = reading.gnss.position_ned[:, :1]
        heard = jnp.where(reading.inbox.mask, reading.inbox.payload[:, :, 0], 0.0).mean(axis=1)
        return qrsim.Say(north, qrsim.VelocitySetpoint.of(jnp.stack([0.01 * heard, 0 * heard, 0 * heard], 1), 0.0))

    world = scenario(controller="velocity")
    one, other = (qrsim.rollout(world, policy, worlds=2, seed=3) for policy in (plain, compiled))
    assert one.metrics["radio_heard"].tolist() == [[10, 10, 10]] * 2
    for name in ("radio_sent", "radio_heard", "radio_lost_queue"):
        np.testing.assert_array_equal(one.metrics[name], other.metrics[name])
    np.testing.assert_allclose(one.metrics["position_ned"], other.metrics["position_ned"], atol=1e-3)


@pytest.mark.long
def test_both_compilers_count_the_same_packets(monkeypatch):
    counts = []
    for compiler in ("llvm", "xla"):
        monkeypatch.setenv("QRSIM_COMPILER", compiler)
        flown = qrsim.Simulation(scenario({**RADIO, "beacon": True}).world(), seed=4)
        flown.reset()
        flown.advance(ticks=101)
        assert flown.compiled_by[0] == compiler
        counts.append(vars(flown.state.radio.counts))
    assert {name: value.tolist() for name, value in counts[0].items()} == {
        name: value.tolist() for name, value in counts[1].items()
    }
    assert counts[0]["heard"].tolist() == [22, 22, 22]


@pytest.mark.long
def test_a_crowd_without_room_is_counted_and_said():
    """110 vehicles within 40 m, and room for 32 in each three columns: nobody sees all, which is said once."""
    places = [(2.0 * (i % 11), 4.0 * (i // 11), -20.0) for i in range(110)]
    crowd = qrsim.make_scenario(
        places,
        radio={"inbox": {"size": 1, "candidates": 2}, "path_loss": {"waves": 1}},
        collision_distance=0.1,
        duration=0.4,
    )
    with pytest.warns(RadioWarning, match=r"world.radio: \d+ times a vehicle had more others around it"):
        found = qrsim.rollout(crowd)
    assert (found.metrics["radio_overfull"] > 0).any()


@pytest.mark.long
def test_double_precision_hears_the_same():
    """With a radio that listens first, which has running sums, choices and counts."""
    radio = {**RADIO, "beacon": True, "mac": {"type": "csma"}}
    heard = []
    for precision in ("float32", "float64"):
        flown = qrsim.Simulation(scenario(radio).world(precision), seed=4)
        flown.reset()
        flown.advance(ticks=31)
        heard.append(flown.reading.inbox)
        assert flown.reading.inbox.rssi.dtype == precision
    np.testing.assert_array_equal(heard[0].sender, heard[1].sender)
    np.testing.assert_allclose(heard[0].rssi, heard[1].rssi, atol=0.01)
    np.testing.assert_allclose(heard[0].age, heard[1].age, atol=1e-6)


def test_a_task_whose_step_is_no_whole_number_of_periods_counts_for_itself():
    """Steps of a second and periods of 0.2 s are in step; with periods of 0.6 s no two worlds need be due together."""
    from qrsim.tasks.play import Play

    for period, expected in ((0.2, True), (0.6, False)):
        made = qrsim.load_scenario(
            {"name": "x", "extends": "cats_and_mouse/1C", "world": {"radio": {"mac": {"period": period}}}}
        )
        assert Play(made.task("float32"), made.world(), 3).in_step is expected
