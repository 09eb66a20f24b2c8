"""Flights by failsafes: where vehicles come to hold, return, land and descend, and how long it takes."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest

import qrsim
from qrsim.apps.check.outcomes import outcomes
from qrsim.control.failsafes import DESCEND, HOLD, LAND, NOTHING, RETURN
from qrsim.runs.streams import EventFinder

IDEAL = {
    "gnss": {"type": "ideal_gnss"},
    "barometer": {"type": "ideal_barometer"},
    "attitude": {"type": "ideal_attitude"},
    "gyroscope": {"type": "ideal_gyroscope"},
    "accelerometer": {"type": "ideal_accelerometer"},
}
FAILSAFES = {
    "COM_LOW_BAT_ACT": 3,
    "NAV_DLL_ACT": "hold",
    "COM_DL_LOSS_T": 5.0,
    "link_to": "station",
    "BAT_LOW_THR": 0.5,
    "BAT_CRIT_THR": 0.4,
    "BAT_EMERGEN_THR": 0.2,
    "RTL_RETURN_ALT": 30.0,
}
BOX = {"type": "box", "x_min": -200.0, "x_max": 200.0, "y_min": -200.0, "y_max": 200.0, "z_min": -60.0, "z_max": 0.0}
RETURNS, LANDS, DESCENDS, HOLDS, FLIES = range(5)


def scenario(failsafes: dict[str, Any] | None = FAILSAFES, faults: tuple[dict[str, Any], ...] = ()) -> dict[str, Any]:
    """Return five X500, in still air and with ideal sensors, that fly from the ground to places 40 m north."""
    places = [20.0 * i for i in range(5)]
    uav = {
        "vehicle": {"type": "multirotor", "model": "x500"},
        "controller": {"type": "cascade"},
        "sensors": IDEAL,
        "battery": {"type": "lithium_cells"},
        "injectable": {"sensors": ["gnss"], "battery": True, "radio": True},
        "failsafes": failsafes,
        "faults": list(faults),
        "vehicles": [
            {"position_ned": [0.0, east, 0.0], "on_ground": True, "waypoints_ned": [[40.0, east, -20.0]]}
            for east in places
        ],
    }
    station = {
        "vehicle": {"type": "fixed_point"},
        "controller": {"type": "none"},
        "vehicles": [{"position_ned": [0.0, -10.0, -2.0]}],
    }
    world = {"area": BOX, "radio": {"preset": "sik_915", "path_loss": {"waves": 2}}}
    return {"name": "failsafes", "duration": 90.0, "world": world, "fleets": {"uav": uav, "station": station}}


@pytest.fixture(scope="module")
def flight() -> tuple[qrsim.Simulation, list[dict[str, Any]]]:
    """Return a simulation 110 s after its start, in which four of five vehicles fail at 20 s, and its events."""
    simulation = qrsim.load(scenario(), seed=3)
    simulation.reset()
    finder, events = EventFinder(simulation), []
    for ticks in (500,) * 11:
        if simulation.tick == 1000:
            simulation.inject("battery", "drop", "uav_0", charge=0.39)
            simulation.inject("battery", "drop", "uav_1", charge=0.19)
            simulation.inject("gnss", "off", "uav_2")
            simulation.inject("radio", "off", "uav_3")
            simulation.inject("radio", "weak", "uav_4", share=0.5)
        history = simulation.record(ticks=ticks, capacity=500)
        events += finder.find(history)
    return simulation, events


def told(events: list[dict[str, Any]], vehicle: int, *kinds: str) -> list[tuple[str, float]]:
    found = [event for event in events if event["vehicle"] == f"uav_{vehicle}" and event["kind"] in kinds]
    return [(event["message"].split(" at ")[0], event["time"]) for event in found]


@pytest.mark.long
def test_each_does_what_it_should_and_comes_down_where_it_should(flight: Any) -> None:
    simulation, events = flight
    own = simulation.state.fleets[0].failsafe
    assert np.asarray(own.action).tolist() == [RETURN, LAND, DESCEND, HOLD, NOTHING]
    assert np.asarray(own.landed).tolist() == [True, True, True, False, False]
    assert simulation.reasons == ["", "", "", "", "", ""]
    place = simulation.truth.position_ned[:5]
    # Home, and where they were; on feet of 0.2 m.
    np.testing.assert_allclose(place[:, 0], [0.0, 40.0, 40.0, 40.0, 40.0], atol=0.3)
    np.testing.assert_allclose(place[:, 1], [0.0, 20.0, 40.0, 60.0, 80.0], atol=0.3)
    np.testing.assert_allclose(place[:, 2], [-0.2, -0.2, -0.2, -20.0, -20.0], atol=0.1)
    assert simulation.compiled_by == ("llvm", "")
    # The failures of others change nothing for the one that flies on.
    assert told(events, FLIES, "failsafe", "failsafe_ends") == []
    start = (float(own.home_ned.x[FLIES]), int(own.since[FLIES]), int(own.phase[FLIES]))
    assert (float(own.place_ned.x[FLIES]), *start[1:]) == (start[0], 0, 0)


@pytest.mark.long
def test_how_long_it_takes(flight: Any) -> None:
    _, events = flight
    landed = {i: told(events, i, "landed")[0][1] - 20.0 for i in (RETURNS, LANDS, DESCENDS)}
    # It follows its path 0.4 s later. From 1.5 m/s at 10 m over home to 0.7 m/s at 5 m takes ln(1.5/0.7)/0.16 s.
    slow = 4.76 + 4.8 / 0.7 + 0.4
    assert landed[LANDS] == pytest.approx(10.0 / 1.5 + 0.38 + slow, abs=0.4)
    # 5 s without a fix, then 19.8 m at 0.7 m/s.
    assert landed[DESCENDS] == pytest.approx(5.0 + 19.8 / 0.7 + 0.18 + 0.4, abs=0.4)
    # Up: to 3 m/s in 1.5 s, 3.25 m at that speed, and from 4.5 to 0.5 m below the top at sqrt(2 h).
    up = 1.5 + 3.25 / 3.0 + (3.0 - 1.0)
    # Home: to 5 m/s in 1.67 s, 27.5 m at that speed, and from 8.3 to 1 m from home at sqrt(3 d).
    home = 1.67 + 27.5 / 5.0 + 2.0 * (1.667 - 0.577)
    # Down to 10 m: to 1.5 m/s in 0.75 s, 18.3 m at that speed, and from 1.125 to 0.5 m above it at sqrt(2 h).
    lower = 0.75 + 18.3 / 1.5 + (1.5 - 1.0)
    assert landed[RETURNS] == pytest.approx(up + home + lower + slow, abs=0.6)


@pytest.mark.long
def test_events_say_why_and_what_and_when(flight: Any) -> None:
    _, events = flight
    kinds = ("failsafe", "failsafe_ends")
    assert told(events, RETURNS, *kinds) == [("uav_0: failsafe: battery critical, return,", 20.04)]
    assert told(events, LANDS, *kinds) == [("uav_1: failsafe: battery emergency, land,", 20.04)]
    [(what, when)] = told(events, DESCENDS, *kinds)
    assert (what, when) == ("uav_2: failsafe: position lost, descend,", pytest.approx(25.02, abs=0.03))
    [(what, when)] = told(events, HOLDS, *kinds)
    # Beacons come in every period, 0.2 s at most.
    assert (what, when) == ("uav_3: failsafe: link lost, hold,", pytest.approx(25.0, abs=0.25))
    event = next(event for event in events if event["kind"] == "failsafe" and event["vehicle"] == "uav_0")
    assert (event["field"], event["value"]) == ("battery", 2.0)


@pytest.mark.long
def test_a_weak_radio_loses_its_share_and_one_that_is_off_all(flight: Any) -> None:
    simulation, _ = flight
    before = simulation.world.radio.counted(simulation.state.radio)
    simulation.advance(ticks=1000)
    after = simulation.world.radio.counted(simulation.state.radio)
    sent, heard = (np.asarray(after[name]) - np.asarray(before[name]) for name in ("sent", "heard"))
    assert (sent[HOLDS], heard[HOLDS]) == (0, 0)
    assert sent[FLIES] == sent[RETURNS] > 0
    # Four others send, the weak one among them: of its packets half are heard, and of those to it half.
    usual, weak = heard[RETURNS], heard[FLIES]
    assert usual / sent[RETURNS] == pytest.approx(3.5, rel=0.1)
    assert weak / sent[FLIES] == pytest.approx(2.0, rel=0.15)


@pytest.mark.long
def test_failsafes_that_have_nothing_to_do_change_no_bit() -> None:
    flown = []
    for failsafes in (FAILSAFES, None):
        simulation = qrsim.load(scenario(failsafes), seed=3)
        simulation.reset()
        simulation.advance(ticks=600)
        flown.append(simulation.state.fleets[0])
    for name in ("vehicle", "controller", "guidance", "setpoint", "readings", "battery", "estimate"):
        one, other = (jax.tree.leaves(getattr(state, name)) for state in flown)
        for mine, theirs in zip(one, other, strict=True):
            np.testing.assert_array_equal(mine, theirs, name)


@pytest.mark.long
def test_a_rollout_counts_them() -> None:
    fault = {"sensor": "gnss", "kind": "off", "start": 8.0, "vehicles": ["uav_2"]}
    flown = qrsim.rollout(scenario(faults=(fault,)), ticks=800, worlds=2)
    found = flown.metrics
    assert found["failsafe_action"].tolist() == [[0, 0, 4, 0, 0, 0]] * 2
    np.testing.assert_allclose(found["failsafe_at_s"][:, 2], 13.0, atol=0.05)
    assert np.isnan(found["failsafe_at_s"][:, [0, 1, 3, 4, 5]]).all()
    # It was nearly at its place; at 16 s, 3 s at 0.7 m/s later, it is lower.
    np.testing.assert_allclose(found["failsafe_position_ned"][:, 2], [[40.0, 40.0, -20.0]] * 2, atol=0.2)
    np.testing.assert_allclose(found["position_ned"][:, 2, 2], -20.0 + 3.0 * 0.7, atol=0.1)
    counted = {outcome.name: outcome for outcome in outcomes(flown)}
    assert (counted["is taken over by a failsafe"].runs, counted["any of these"].runs) == (2, 2)
    assert counted["is taken over by a failsafe"].worst.position_ned == pytest.approx((40.0, 40.0, -20.0), abs=0.2)
    assert counted["crashes"].runs == counted["is still on its mission at the end"].runs == 0
    assert (found["reason"] == 0).all()


@pytest.mark.long
def test_nothing_fails_where_a_flight_has_ended() -> None:
    simulation = qrsim.load(scenario(), seed=3)
    simulation.reset()
    simulation.advance(ticks=500)
    simulation.inject("battery", "drop", "uav_0", charge=0.0)
    # Sensors of a vehicle that has stopped are silent; after 5 s a flying one would have lost its position.
    simulation.advance(ticks=300)
    assert simulation.reasons[0] == "battery_empty: charge = 0"
    own = simulation.state.fleets[0].failsafe
    assert np.asarray(own.action).tolist() == [NOTHING] * 5
    assert not np.asarray(own.landed).any()
