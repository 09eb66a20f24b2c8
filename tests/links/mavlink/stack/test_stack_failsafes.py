"""Failsafes of battery, fence and link, each with every action; and parameters: types, limits, and that they count."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from puppet import DT, Puppet, item

from qrsim.links.mavlink.stack.codes import Breach, PlanKind
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.links.mavlink.stack.offboard import LocalTarget
from qrsim.links.mavlink.stack.parameters import INT32, REAL32, TABLE, Outcome, Parameters

FENCE = ((-30.0, -30.0), (-30.0, 30.0), (30.0, 30.0), (30.0, -30.0))
OFFBOARD = 0x00060000


@pytest.mark.parametrize(
    ("action", "critical", "emergency"),
    [(0, Mode.HOLD, Mode.HOLD), (1, Mode.HOLD, Mode.HOLD), (2, Mode.LAND, Mode.LAND), (3, Mode.RTL, Mode.LAND)],
)
def test_a_battery_that_runs_down(action, critical, emergency):
    puppet = Puppet()
    puppet.stack.parameters.set("COM_LOW_BAT_ACT", action)
    puppet.fly_up(30.0)
    puppet.said.clear()
    puppet.seen.charge = 0.16
    puppet.run(0.1)
    assert puppet.texts == []
    # 15 %, 7 % and 5 %.
    puppet.seen.charge = 0.149
    puppet.run(1.0)
    assert puppet.texts == ["Low battery level: 15 %"]
    assert puppet.stack.mode is Mode.HOLD
    puppet.seen.charge = 0.069
    puppet.run(1.0)
    assert puppet.stack.mode is critical
    puppet.seen.charge = 0.049
    puppet.run(1.0)
    assert puppet.stack.mode is emergency
    levels = [text for text in puppet.texts if "battery" in text]
    assert [text.split(" level")[0] for text in levels] == ["Low battery", "Critical battery", "Dangerous battery"]
    assert not puppet.stack.health().healthy & 0x2000000


def test_no_battery_fails_over_nothing():
    puppet = Puppet()
    puppet.stack.parameters.set("COM_LOW_BAT_ACT", 3)
    puppet.seen.charge = float("nan")
    puppet.fly_up(5.0)
    assert puppet.stack.mode is Mode.HOLD
    assert not puppet.stack.health().present & 0x2000000


@pytest.mark.parametrize(
    ("action", "mode"),
    [(0, Mode.OFFBOARD), (1, Mode.OFFBOARD), (2, Mode.HOLD), (3, Mode.RTL), (4, None), (5, Mode.LAND)],
)
def test_a_fence_that_is_crossed(action, mode):
    puppet = Puppet()
    corners = [item(i, 5001, *corner, 0.0, frame=5, params=(4, 0, 0, 0)) for i, corner in enumerate(FENCE)]
    assert puppet.stack.accept(PlanKind.FENCE, corners)[0] == 0
    puppet.stack.parameters.set("GF_ACTION", action)
    puppet.fly_up()
    target = LocalTarget(1, 0x9C7, velocity=(4.0, 0.0, 0.0), yaw=0.0)
    puppet.stack.setpoint(target)
    assert puppet.stack.set_mode(1, OFFBOARD) == 0
    assert puppet.stack.health().healthy & 0x100000
    assert puppet.run(20.0, lambda now: now.seen.position_ned[0] > 30.0, lambda now: now.stack.setpoint(target))
    puppet.run(0.12, each=lambda now: now.stack.setpoint(target))
    said = [text for text in puppet.texts if "Geofence" in text]
    assert said == ([] if action == 0 else ["Geofence breached: outside the area"])
    assert bool(puppet.stack.health().healthy & 0x100000) == (action == 0)
    if mode is None:
        assert puppet.stack.craft.terminated
    else:
        assert puppet.stack.mode is mode
        assert puppet.stack.armed
    # Said once, and done once.
    puppet.run(1.0, each=lambda now: now.stack.setpoint(target))
    assert len([text for text in puppet.texts if "Geofence" in text]) == len(said)


def test_the_area_of_the_scenario_is_never_left():
    for speed in (1.0, 4.0, 8.0):
        puppet = Puppet(fence=FENCE)
        # A larger fence of a client does not take that guard away.
        wide = item(0, 5003, 0.001, 0.0, 0.0, frame=5, params=(500.0, 0, 0, 0))
        assert puppet.stack.accept(PlanKind.FENCE, [wide])[0] == 0
        puppet.fly_up()
        target = LocalTarget(1, 0x9C7, velocity=(speed, 0.0, 0.0), yaw=0.0)
        puppet.stack.setpoint(target)
        assert puppet.stack.set_mode(1, OFFBOARD) == 0
        north = [0.0]

        def push(now: Puppet, target=target, north=north) -> None:
            now.stack.setpoint(target)
            north.append(now.seen.position_ned[0])

        assert puppet.run(60.0, lambda now: now.stack.mode is Mode.HOLD, push)
        # Where 1.8 m/s^2 still stops it, and it has half a second to answer: 1.25, 5.85 and 19.2 m, and 0.5 s.
        expected = 30.0 - {1.0: 1.25, 4.0: 5.85, 8.0: 19.18}[speed] - 0.5 * speed
        # It is looked at every 0.1 s, and acted upon within three ticks.
        assert 0.0 <= puppet.seen.position_ned[0] - expected <= 0.16 * speed
        assert "Geofence breached: about to leave the area of the scenario" in puppet.texts
        puppet.run(10.0, each=push)
        assert max(north) < 30.0


def test_a_fence_of_distance_and_height():
    puppet = Puppet()
    puppet.stack.parameters.set("GF_MAX_VER_DIST", 8.0)
    puppet.do(400, 1)
    puppet.do(22, *[float("nan")] * 6, 503.0)
    assert puppet.run(10.0, lambda now: now.stack.mode is Mode.HOLD)
    assert puppet.texts[-2] == "Geofence breached: higher than 8 m over home"
    assert -puppet.seen.position_ned[2] == pytest.approx(8.1, abs=0.3)
    # Said at the breach, by the ceiling, and where it ends.
    began = puppet.seen.time
    status = puppet.stack.fence()
    assert (status.breached, status.count, status.breach) == (True, 1, Breach.CEILING)
    assert status.time == pytest.approx(began, abs=0.05)
    assert len(puppet.kinds("fence")) == 1
    puppet.stack.parameters.set("GF_MAX_VER_DIST", 0.0)
    puppet.run(0.2)
    assert len(puppet.kinds("fence")) == 2
    status = puppet.stack.fence()
    assert (status.breached, status.count, status.breach) == (False, 1, Breach.CEILING)
    puppet = Puppet()
    puppet.stack.accept(PlanKind.MISSION, [item(0, 16, 60, 0, 6.0)])
    assert puppet.do(300) == 0
    # Before its start the mission would be rejected for it.
    puppet.stack.parameters.set("GF_MAX_HOR_DIST", 12.0)
    assert puppet.run(30.0, lambda now: now.stack.mode is Mode.HOLD)
    assert "Geofence breached: farther than 12 m from home" in puppet.texts
    assert puppet.stack.fence().breach is Breach.BOUNDARY
    assert puppet.seen.position_ned[0] == pytest.approx(12.2, abs=0.6)


def test_nothing_milder_ends_a_return():
    puppet = Puppet(fence=FENCE)
    puppet.fly_up()
    puppet.do(20)
    puppet.seen.position_ned = (31.0, 0.0, -10.0)
    puppet.run(0.2)
    assert "Geofence breached: outside the area" in puppet.texts
    assert puppet.stack.mode is Mode.RTL


@pytest.mark.parametrize(
    ("action", "mode", "armed"),
    [
        (0, Mode.HOLD, True),
        (1, Mode.HOLD, True),
        (2, Mode.RTL, True),
        (3, Mode.LAND, True),
        (5, Mode.HOLD, False),
        (6, Mode.HOLD, False),
    ],
)
def test_a_link_to_the_ground_that_is_lost(action, mode, armed):
    puppet = Puppet()
    puppet.stack.parameters.set("NAV_DLL_ACT", action)
    puppet.fly_up()
    puppet.run(15.0)
    # Nobody who was never heard is lost.
    assert puppet.stack.mode is Mode.HOLD
    puppet.stack.heard_ground()
    puppet.run(9.9)
    assert "Link to the ground lost" not in puppet.texts
    puppet.run(0.2)
    assert puppet.texts.count("Link to the ground lost") == 1
    assert (puppet.stack.mode, puppet.stack.armed) == (mode, armed)
    puppet.stack.heard_ground()
    puppet.run(DT)
    assert puppet.texts[-1] == "Link to the ground regained"


def test_a_blind_vehicle_sinks_level():
    puppet = Puppet()
    puppet.fly_up(3.0)
    puppet.seen.valid = False
    puppet.run(DT)
    assert puppet.order.kind == "attitude"
    # A little less than the throttle of hover, 0.5.
    assert puppet.order.numbers[:2] + puppet.order.numbers[3:] == pytest.approx((0.0, 0.0, 0.475))


def test_what_is_not_known_gets_into_no_order():
    nowhere = (float("nan"),) * 3
    puppet = Puppet()
    puppet.fly_up(10.0)
    real = puppet.seen
    blind = replace(real, valid=False, position_ned=nowhere, velocity_ned=nowhere, attitude=nowhere)
    for id in (20, 21, 20):
        assert puppet.do(id) == 0
        blind.time += DT
        order = puppet.stack.tick(blind)
        assert all(map(math.isfinite, order.numbers))
    # It goes on with the return when it sees again.
    real.time = blind.time
    assert puppet.run(80.0, lambda now: not now.stack.armed)
    assert puppet.seen.position_ned[:2] == pytest.approx((0.0, 0.0), abs=0.5)


def test_who_is_armed_by_force_without_an_estimate_gives_finite_orders():
    nowhere = (float("nan"),) * 3
    puppet = Puppet(settle=0.0)
    puppet.seen = replace(puppet.seen, valid=False, position_ned=nowhere, velocity_ned=nowhere, attitude=nowhere)
    puppet.stack.tick(puppet.seen)
    assert puppet.do(400, 1, 21196) == 0
    assert puppet.do(22) == 1
    order = puppet.stack.tick(puppet.seen)
    assert order is None or all(map(math.isfinite, order.numbers))
    assert puppet.stack.home is None


# ---- parameters ----


def test_parameters_are_listed_typed_and_limited():
    parameters = Parameters({"MAV_SYS_ID": 7, "MPC_THR_HOVER": 0.77})
    names = [one.name for one in parameters]
    assert len(parameters) == len(names) == len(set(names)) == len(TABLE)
    assert names == sorted(names)
    assert all(len(name) <= 16 for name in names)
    assert all(one.low <= one.default <= one.high and one.type in (INT32, REAL32) and one.doc for one in parameters)
    assert parameters["MAV_SYS_ID"] == 7
    assert parameters["MPC_THR_HOVER"] == 0.77
    assert parameters.at(parameters.index("GF_ACTION")).name == "GF_ACTION"
    assert parameters.at(-1) is None
    assert parameters.at(len(parameters)) is None
    assert "NONE" not in parameters


# PX4's parameter files.
DEFAULTS = {
    "MIS_TAKEOFF_ALT": 2.5, "RTL_RETURN_ALT": 60.0, "RTL_DESCEND_ALT": 10.0, "COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0,
    "COM_DISARM_LAND": 2.0, "COM_DISARM_PRFLT": 10.0, "COM_LOW_BAT_ACT": 0, "BAT_LOW_THR": 0.15, "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05, "GF_ACTION": 2, "MPC_XY_CRUISE": 5.0, "MPC_XY_VEL_MAX": 12.0, "MPC_Z_VEL_MAX_UP": 3.0,
    "MPC_Z_VEL_MAX_DN": 1.5, "MPC_LAND_SPEED": 0.7, "MPC_TKO_SPEED": 1.5, "NAV_ACC_RAD": 2.0, "NAV_DLL_ACT": 0,
    "SYS_AUTOSTART": 4001, "COM_RC_IN_MODE": 1, "COM_RC_LOSS_T": 0.5, "COM_RC_OVERRIDE": 1,
    "NAV_RCL_ACT": 2, "MPC_MAN_TILT_MAX": 35.0, "MPC_MAN_Y_MAX": 150.0, "MPC_VEL_MANUAL": 10.0, "MPC_THR_HOVER": 0.5,
    "FLW_TGT_DST": 8.0, "FLW_TGT_HT": 8.0, "FLW_TGT_FA": 180.0, "FLW_TGT_ALT_M": 0, "FLW_TGT_MAX_VEL": 5.0,
}  # fmt: skip


def test_parameters_have_the_defaults_of_px4():
    parameters = Parameters()
    assert {name: parameters[name] for name in DEFAULTS} == DEFAULTS


@pytest.mark.parametrize(
    ("name", "value", "type", "outcome", "after"),
    [
        ("MIS_TAKEOFF_ALT", 12.0, REAL32, Outcome.SET, 12.0),
        ("MIS_TAKEOFF_ALT", 12.0, None, Outcome.SET, 12.0),
        ("MIS_TAKEOFF_ALT", 500.0, REAL32, Outcome.CLAMPED, 80.0),
        ("MIS_TAKEOFF_ALT", -1.0, REAL32, Outcome.CLAMPED, 0.0),
        ("MIS_TAKEOFF_ALT", 12.0, INT32, Outcome.WRONG_TYPE, 2.5),
        ("MIS_TAKEOFF_ALT", float("nan"), REAL32, Outcome.NOT_FINITE, 2.5),
        ("GF_ACTION", 3.0, INT32, Outcome.SET, 3),
        ("GF_ACTION", 99.0, INT32, Outcome.CLAMPED, 5),
        ("GF_ACTION", 3.0, REAL32, Outcome.WRONG_TYPE, 2),
        ("MAV_SYS_ID", 3.0, INT32, Outcome.READ_ONLY, 1),
    ],
)
def test_a_parameter_is_set_clamped_or_refused(name, value, type, outcome, after):
    parameters = Parameters()
    assert parameters.set(name, value, type) is outcome
    assert parameters[name] == after


def test_an_unknown_parameter_is_said():
    assert Parameters().set("MIS_TAKEOFF", 1.0) is Outcome.UNKNOWN
    with pytest.raises(KeyError):
        Parameters({"MIS_TAKEOFF": 1.0})
    assert Parameters().parameter("MIS_TAKEOFF") is None


def test_parameters_change_the_flight():
    puppet = Puppet()
    puppet.stack.parameters.set("MIS_TAKEOFF_ALT", 6.0)
    puppet.stack.parameters.set("MPC_TKO_SPEED", 0.5)
    puppet.do(400, 1)
    puppet.do(22)
    puppet.run(6.0)
    assert -puppet.seen.velocity_ned[2] == pytest.approx(0.5, abs=0.02)
    puppet.run(10.0)
    assert -puppet.seen.position_ned[2] == pytest.approx(6.0, abs=0.1)
    puppet.stack.parameters.set("COM_DISARM_LAND", -1.0)
    puppet.do(21)
    puppet.run(30.0)
    assert puppet.seen.on_ground
    assert puppet.stack.armed


def test_a_reset_is_a_boot_that_keeps_plans_and_parameters():
    puppet = Puppet()
    puppet.stack.accept(PlanKind.MISSION, [item(0, 16, 30, 0, 6.0)])
    puppet.stack.parameters.set("MIS_TAKEOFF_ALT", 6.0)
    puppet.fly_up()
    puppet.stack.reset()
    assert not puppet.stack.armed
    assert puppet.stack.home is None
    assert puppet.stack.parameters["MIS_TAKEOFF_ALT"] == 6.0
    assert len(puppet.stack.items(PlanKind.MISSION)) == 1
