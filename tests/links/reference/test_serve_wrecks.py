"""Wrecks in a shared world: the others fly on, the wreck lies still in what clients read, and commands are answered."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
import pytest
from shared_worlds import SEED, A, B, goal, together

pytestmark = pytest.mark.long


def test_a_wreck_lies_still_answers_its_client_and_changes_no_bit_of_the_others(barrier):
    """One lets its vehicle fall out of the area, or holds it: 100 ticks are 2 s."""
    _, connect = barrier
    flights = []
    for order in (("attitude", [0.3, 0.0, 0.0, 0.0]), ("waypoint", goal(1, 0))):
        one, other = connect(), connect()
        one.restart(SEED)
        one.claim(A)
        other.claim(B)
        seen = []
        for k in range(20):
            seen.append(
                together(
                    partial(one.advance, {A: ("waypoint", goal(0, k))}, ticks=10, truth=True),
                    partial(other.advance, {B: order}, ticks=10, truth=True),
                )
            )
        flights.append((seen[-1][0].vehicles[A].state.tobytes(), [found.vehicles[B] for _, found in seen]))
        one.close()
        other.close()
    (left, fallen), (right, held) = flights
    assert left == right
    assert all(vehicle.valid for vehicle in held)
    # It fell 12 m, which takes at least 1.56 s, and longer in air.
    first = next(k for k, vehicle in enumerate(fallen) if not vehicle.valid)
    assert 7 <= first < 16
    for wreck in fallen[first:]:
        assert wreck.reason.startswith("out_of_area: position_ned.z = ")
        np.testing.assert_array_equal(wreck.state, fallen[-1].state)
        assert np.isnan(wreck.sensors["gnss"]["position_ned"]).all()
    np.testing.assert_array_equal(fallen[-1].state[6:12], np.zeros(6))


def test_a_command_to_a_wreck_is_answered_in_a_free_world(free):
    _, connect = free
    client = connect()
    client.restart(SEED)
    # After half a second without an order.
    client.claim(A, on_silence="stop")
    client.subscribe(truth=True)
    end = time.monotonic() + 30.0
    while (found := client.sensed().vehicles[A]).valid:
        assert time.monotonic() < end
    before = client.sensed()
    assert client.command({A: ("waypoint", goal(0, 0))}) > before.tick
    while (after := client.sensed()).tick < before.tick + 10:
        assert time.monotonic() < end
    np.testing.assert_array_equal(after.vehicles[A].state, found.state)
    assert after.vehicles[A].reason == found.reason != ""
    client.release()
