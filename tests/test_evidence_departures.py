"""The variants of tests/control/published.py are what was published; the study of them finds what the page shows."""

from __future__ import annotations

import json
from pathlib import Path

import jax.numpy as jnp
import pytest
from evidence import departures
from tests.control.published import PublishedVelocityHeight, PublishedWaypoint, PublishedWind

from qrsim.control.controllers import VelocityHeightController, WaypointController
from qrsim.control.setpoints import Estimate, VelocityHeightSetpoint, WaypointSetpoint
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.models.vehicles.quadrotor import Command, Quadrotor, QuadrotorState

EVIDENCE = Path(__file__).resolve().parent.parent / "docs" / "evidence" / "departures.json"
# Nose up by 0.3 rad and climbing at 2 m/s: u = 2 sin 0.3 = 0.591040 m/s, though nothing moves over the ground.
CLIMBING = Estimate.of([[0.0, 0.0, -10.0]], [[0.0, 0.0, -2.0]], [[0.0, 0.3, 0.0]])


def pitch_of(controller, setpoint) -> float:
    return float(controller.step(controller.init(CLIMBING), CLIMBING, setpoint, 0.02)[1].pitch[0])


def test_the_published_waypoint_controller_takes_a_climb_for_speed() -> None:
    setpoint = WaypointSetpoint.of([[0.0, 0.0, -10.0]])
    assert pitch_of(PublishedWaypoint(), setpoint) == pytest.approx(0.09 * 0.591040, rel=1e-5)
    assert pitch_of(WaypointController(), setpoint) == pytest.approx(0.0, abs=1e-6)


def test_the_published_velocity_height_controller_takes_a_climb_for_an_error() -> None:
    setpoint = VelocityHeightSetpoint.of([[0.0, 0.0]], -10.0)
    assert pitch_of(PublishedVelocityHeight(), setpoint) == pytest.approx(0.25 * 0.591040, rel=1e-5)
    assert pitch_of(VelocityHeightController(), setpoint) == pytest.approx(0.0, abs=1e-6)


def test_the_published_wind_does_not_turn_within_a_step() -> None:
    """At 1 rad/s of pitch rate, 10 m/s of air along x are 10 sin 0.02 m/s along z at the end of a step of 20 ms."""
    zero, one = jnp.zeros(1), jnp.ones(1)
    level, still = Vec3(zero, zero, zero), ProcessNoise(Vec3(zero, zero, zero), Vec3(zero, zero, zero))
    state = QuadrotorState(level, Euler(zero, zero, zero), level, Vec3(zero, one, zero), 16.4808 * one)
    command = Command(zero, zero, 0.59 * one, zero, 12.0 * one)

    def down(vehicle: Quadrotor) -> float:
        air = Vec3(10.0 * one, zero, zero)
        moved, _ = vehicle.step(state, command, lambda trig: trig.rotation().to_body(air), still, 0.02)
        return float(moved.velocity_body.z[0])

    expected = 0.5 * 0.02 * 1.35341 * 0.1999867
    assert down(Quadrotor()) - down(PublishedWind()) == pytest.approx(expected, rel=1e-3)


@pytest.mark.long
def test_the_small_form_finds_what_the_page_shows() -> None:
    measured = json.loads(EVIDENCE.read_text(encoding="utf-8"))["results"]["waypoint"]
    found = departures.run(full=False, parts=("waypoint",))["waypoint"]
    # The largest difference comes within the first 20 s.
    assert found["largest_m"] == pytest.approx(measured["largest_m"], rel=1e-3)
    assert found["largest_m_s"] == pytest.approx(measured["largest_m_s"], rel=1e-3)
