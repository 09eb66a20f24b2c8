"""The object a user flies: loading, stepping, what it shows, and what it says to every bad input."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.control import Estimate, VelocitySetpoint, WaypointSetpoint
from qrsim.core.tree import replace
from qrsim.errors import ScenarioError, UsageError
from qrsim.models.vehicles.quadrotor import COMMAND_FIELDS, COMMAND_LIMITS, Command
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.arguments import LARGEST_TICK
from qrsim.simulation.simulation import Simulation
from small_worlds import ALPHA, BRAVO, quiet, simulate

HOVER = [0.0, 0.0, 0.59, 0.0, 12.0]
STARTS = np.asarray([start for start, _, _ in (*ALPHA, *BRAVO)])


@pytest.fixture(scope="module")
def shared() -> Simulation:
    """Five vehicles of two fleets, which no test may step."""
    return simulate(quiet())


@pytest.fixture
def flying() -> Simulation:
    """The same, for a test of its own; the compiled programs are shared."""
    return simulate(quiet())


def hover() -> np.ndarray[Any, Any]:
    return np.tile(HOVER, (5, 1))


def said(call: Any, *arguments: Any, **options: Any) -> str:
    """Return the message of the UsageError that a call ends in."""
    with pytest.raises(UsageError) as caught:
        call(*arguments, **options)
    return str(caught.value)


# Loading


def test_a_simulation_is_loaded_by_name_by_path_or_from_a_dict(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(load_scenario("hover_ideal").to_yaml())
    content = load_scenario("hover_ideal").spec.model_dump(mode="json")
    states = []
    for source in ("hover_ideal", path, str(path), content):
        simulation = qrsim.load(source, seed=2)
        simulation.reset()
        assert (simulation.name, simulation.size, simulation.seed, simulation.precision) == (
            "hover_ideal",
            1,
            2,
            "float32",
        )
        states.append(simulation.truth.state)
    for state in states[1:]:
        np.testing.assert_array_equal(state, states[0])


def test_overrides_and_precision_are_part_of_loading() -> None:
    simulation = qrsim.load(
        "hover_ideal", overrides=["fleets.pelicans.vehicles.0.position_ned.2=-25", "time_step=0.01"]
    )
    assert simulation.precision == "float32"
    assert simulation.world.time_step == 0.01
    assert simulation.world.fleets[0].start.position_ned.z.tolist() == [-25.0]
    assert qrsim.load("hover_ideal", precision="float64").precision == "float64"


def test_what_cannot_be_loaded_is_named() -> None:
    assert "no scenario is called 'hovver'; did you mean 'hover'?" in said(qrsim.load, "hovver")
    assert "nowhere.yaml: no such file" in said(qrsim.load, "nowhere.yaml")
    assert "expected a name" in said(qrsim.load, None)
    with pytest.raises(ScenarioError, match=r"world\.wnd: no such parameter of 'world'; did you mean 'wind'\?"):
        qrsim.load("hover_ideal", overrides=["world.wnd=calm"])
    with pytest.raises(TypeError):
        qrsim.load("hover_ideal", 3)  # type: ignore[misc]


@pytest.mark.parametrize(
    ("precision", "hint"),
    [("float16", "did you mean 'float"), ("Float32", "did you mean 'float32'?"), ("half", "known: float32, float64")],
)
def test_an_unknown_precision_is_named_with_the_nearest(precision: str, hint: str) -> None:
    message = said(qrsim.load, "hover", precision=precision)
    assert message.startswith(f"precision: '{precision}' is not known")
    assert hint in message


@pytest.mark.parametrize("seed", [-1, 1.0, 2**63, True, "1", None, math.nan])
def test_a_seed_that_is_no_such_integer_is_refused(seed: Any) -> None:
    expected = f"seed: {seed!r} is not an integer from 0 to 2**63 - 1"
    assert said(qrsim.load, "hover", seed=seed) == expected
    simulation = qrsim.load("hover_ideal", seed=7)
    if seed is not None:
        assert said(simulation.reset, seed=seed) == expected
    assert simulation.seed == 7


@pytest.mark.parametrize("seed", [0, 2**32 - 1, 2**32, 2**63 - 1, np.int64(5), np.uint8(5)])
def test_every_integer_of_the_range_is_a_seed(seed: Any) -> None:
    simulation = qrsim.load("hover_ideal", seed=seed)
    simulation.reset()
    assert simulation.seed == int(seed)


def test_what_is_no_world_is_refused() -> None:
    with pytest.raises(UsageError, match=r"world: expected a World, found str; qrsim\.load\(\.\.\.\) makes"):
        Simulation("hover")  # type: ignore[arg-type]


def test_seeds_that_differ_only_above_32_bits_differ() -> None:
    drifts = [simulate_drift(seed) for seed in (5, 5 + 2**32, 5 + 2**62)]
    assert len({float(drift) for drift in drifts}) == 3


def simulate_drift(seed: int) -> Any:
    simulation = qrsim.load("patrol_published", seed=seed)
    simulation.reset()
    return simulation.state.fleets[0].sensors[1].drift[0]


# What it shows


def test_nothing_is_shown_before_the_first_reset() -> None:
    simulation = qrsim.load("hover_ideal")
    assert (simulation.tick, simulation.time, simulation.size) == (0, 0.0, 1)
    for attribute in ("reading", "truth", "valid", "reasons", "state", "history"):
        assert said(getattr, simulation, attribute) == "the simulation has not started: call reset() first"
    for call in (simulation.step, lambda: simulation.record(3)):
        assert said(call) == "the simulation has not started: call reset() first"


def test_the_truth_has_plain_arrays_of_all_vehicles(shared: Simulation) -> None:
    truth = shared.truth
    shapes = {
        "position_ned": (5, 3), "attitude": (5, 3), "velocity_body": (5, 3), "velocity_ned": (5, 3),
        "rates_body": (5, 3), "thrust": (5,), "specific_force": (5, 3), "wind_ned": (5, 3), "command": (5, 5),
        "state": (5, 13),
    }  # fmt: skip
    for name, shape in shapes.items():
        value = getattr(truth, name)
        assert isinstance(value, np.ndarray), name
        # Positions have two parts of single precision.
        dtype = np.float64 if name in ("position_ned", "state") else np.float32
        assert (value.shape, value.dtype) == (shape, dtype), name
    np.testing.assert_array_equal(truth.position_ned, STARTS.astype(np.float32))
    np.testing.assert_allclose(truth.thrust, 1.68 * 9.81, rtol=1e-6)
    np.testing.assert_array_equal(truth.state[:, :3], truth.position_ned)
    np.testing.assert_array_equal(truth.state[:, 12], truth.thrust)


def test_valid_and_reasons_are_one_per_vehicle(shared: Simulation) -> None:
    assert (shared.valid.shape, shared.valid.dtype) == ((5,), np.bool_)
    assert shared.valid.all()
    assert shared.reasons == [""] * 5


def test_readings_are_found_by_fleet_sensor_and_field(shared: Simulation) -> None:
    reading = shared.reading
    assert reading.time == 0.0
    assert reading.fleets == ("alpha", "bravo")
    assert reading["alpha"].gnss.position_ned.shape == (3, 3)
    assert reading["bravo"].height.height.shape == (2,)
    assert {"height", "height_rate"} <= set(reading["bravo"].height.fields)
    assert "alpha" in repr(reading)
    assert "gnss" in repr(reading["alpha"])
    assert "position_ned" in repr(reading["alpha"].gnss)


def test_with_one_fleet_its_name_can_be_left_out() -> None:
    simulation = qrsim.load("hover_ideal")
    reading = simulation.reset()
    np.testing.assert_array_equal(reading.gnss.position_ned, reading["pelicans"].gnss.position_ned)
    with pytest.raises(AttributeError, match=r"no sensor is called 'gns'; did you mean 'gnss'\?"):
        _ = reading.gns


def test_unknown_fleets_sensors_and_fields_are_named_with_the_nearest(shared: Simulation) -> None:
    reading = shared.reading
    assert said(lambda: reading["alfa"]) == "no fleet is called 'alfa'; did you mean 'alpha'?"
    assert said(lambda: reading["xyz"]) == "no fleet is called 'xyz'; known: alpha, bravo"
    with pytest.raises(AttributeError, match=r"no sensor is called 'barometr'; did you mean 'barometer'\?"):
        _ = reading["alpha"].barometr
    with pytest.raises(AttributeError, match=r"no sensor is called 'gnss'; known: height"):
        _ = reading["bravo"].gnss
    with pytest.raises(AttributeError, match=r"sensor 'gnss' has no 'positon_ned'; did you mean 'position_ned'\?"):
        _ = reading["alpha"].gnss.positon_ned
    with pytest.raises(AttributeError, match=r"'gnss': there are several fleets; name one, reading\['alpha'\]\.gnss"):
        _ = reading.gnss
    assert not hasattr(reading["alpha"], "camera")


def test_what_is_shown_stays_when_the_simulation_goes_on(flying: Simulation) -> None:
    truth, reading = flying.truth, flying.reading
    position, height = truth.position_ned.copy(), reading["bravo"].height.height.copy()
    flying.step(ticks=30)
    np.testing.assert_array_equal(truth.position_ned, position)
    np.testing.assert_array_equal(reading["bravo"].height.height, height)
    assert reading.time == 0.0
    assert not np.array_equal(flying.truth.position_ned, position)


# Stepping


def test_a_step_returns_the_reading_at_its_end(flying: Simulation) -> None:
    reading = flying.step()
    assert (flying.tick, reading.time, flying.time) == (1, 0.02, 0.02)
    reading = flying.step(None, ticks=np.int64(49))
    assert (flying.tick, flying.time) == (50, 1.0)
    assert reading.time == 1.0
    np.testing.assert_array_equal(reading["alpha"].gnss.position_ned, flying.truth.position_ned[:3].astype(np.float32))


def test_without_a_command_every_fleet_flies_its_route(flying: Simulation) -> None:
    flying.step(ticks=100)
    goals = np.asarray([waypoint for _, waypoint, _ in (*ALPHA, *BRAVO)])
    before = np.linalg.norm(goals - STARTS, axis=1)
    now = np.linalg.norm(goals - flying.truth.position_ned, axis=1)
    assert np.all(now < before)


def test_an_array_of_commands_is_flown_as_it_is_by_the_vehicle_of_its_row(flying: Simulation) -> None:
    command = hover()
    command[:, 0] = [0.1, -0.1, 0.0, 0.2, -0.2]
    command[:, 1] = [0.0, 0.0, 0.3, 0.0, -0.3]
    command[:, 4] = [12.0, 11.0, 10.0, 12.0, 9.0]
    flying.step(command, ticks=25)
    # The battery's voltage is the model's, not the command's, where a fleet has a battery.
    np.testing.assert_array_equal(flying.truth.command[:, :4], command[:, :4].astype(np.float32))
    # Nose up (positive pitch) flies backwards; right side down (positive roll) flies to the right.
    assert np.sign(flying.truth.position_ned[:, 0] - STARTS[:, 0]).tolist() == [-1.0, 1.0, 0.0, -1.0, 1.0]
    assert np.sign(flying.truth.position_ned[:, 1] - STARTS[:, 1]).tolist() == [0.0, 0.0, 1.0, 0.0, -1.0]


def test_a_command_can_be_a_list_an_integer_array_or_a_record(flying: Simulation) -> None:
    ends = []
    columns = hover().astype(np.float32).T
    for command in (hover(), hover().tolist(), hover().astype(np.float32), Command(*columns)):
        flying.reset()
        flying.step(command, ticks=3)
        ends.append(flying.truth.state)
    for end in ends[1:]:
        np.testing.assert_array_equal(end, ends[0])
    flying.step(np.tile([0, 0, 1, 0, 12], (5, 1)))


def test_a_set_point_is_flown_to_by_the_controllers() -> None:
    simulation = qrsim.load("hover_ideal")
    simulation.reset()
    start = simulation.truth.position_ned
    target = start + np.array([[3.0, -2.0, -2.0]])
    setpoint = simulation.waypoint(target, yaw_rad=0.5)
    assert isinstance(setpoint, WaypointSetpoint)
    simulation.step(setpoint, ticks=200)
    error = np.linalg.norm(simulation.truth.position_ned - target, axis=1)
    assert np.all(error < 0.5 * np.linalg.norm(target - start, axis=1))
    np.testing.assert_allclose(simulation.truth.attitude[:, 2], 0.5, atol=0.02)
    flown = simulation.state.fleets[0].setpoint
    np.testing.assert_array_equal(flown.position_ned.stack(), target.astype(np.float32))
    # Without one the route counts again.
    simulation.step()
    np.testing.assert_array_equal(simulation.state.fleets[0].setpoint.position_ned.stack(), start)


def test_one_set_point_can_be_for_all(shared: Simulation) -> None:
    setpoint = shared.waypoint([1.0, 2.0, -3.0], 0.5)
    assert setpoint.position_ned.x.tolist() == [1.0] * 5
    assert setpoint.position_ned.z.tolist() == [-3.0] * 5
    assert setpoint.yaw.tolist() == [0.5] * 5


# Bad input; nothing of it moves the simulation


@pytest.mark.parametrize(
    ("command", "found"),
    [
        (np.zeros(5), "found shape (5,)"),
        (np.zeros((4, 5)), "found shape (4, 5)"),
        (np.zeros((5, 4)), "found shape (5, 4)"),
        (np.zeros((1, 5, 5)), "found shape (1, 5, 5)"),
        (3.0, "found shape ()"),
        ([], "found shape (0,)"),
        ([[0.0] * 5, [0.0] * 4], "found rows of different lengths"),
        (object(), "found shape ()"),
    ],
)
def test_a_command_of_the_wrong_shape_is_refused(shared: Simulation, command: Any, found: str) -> None:
    expected = f"command: expected shape (5, 5) (vehicles; {', '.join(COMMAND_FIELDS)}), {found}"
    assert said(shared.step, command) == expected
    assert said(shared.record, 3, command) == expected
    assert shared.tick == 0


@pytest.mark.parametrize("command", ["hover", b"hover"])
def test_a_command_of_another_kind_is_refused(shared: Simulation, command: Any) -> None:
    assert said(shared.step, command) == (
        "command: expected an array (5, 5), a set-point, one of these for each fleet by name, or None, "
        f"found {command!r}"
    )


@pytest.mark.long
def test_each_fleet_can_be_asked_for_something_else(flying: Simulation) -> None:
    """Fleet alpha flies to waypoints while bravo is commanded, as in a simulation where all are."""
    start = flying.save()
    everybody = np.concatenate([flying.truth.position_ned[:3] + np.array([3.0, 0.0, -1.0]), np.zeros((2, 3))])
    flying.step(flying.waypoint(everybody), ticks=20)
    alpha = flying.truth.state[:3]
    flying.load(start)
    flying.step(hover(), ticks=20)
    bravo = flying.truth.state[3:]
    flying.load(start)
    flying.step({"alpha": WaypointSetpoint.of(everybody[:3]), "bravo": hover()[3:]}, ticks=20)
    np.testing.assert_allclose(flying.truth.state, np.concatenate([alpha, bravo]), rtol=1e-6, atol=1e-6)
    flying.load(start)


def test_an_unknown_fleet_and_a_set_point_of_another_kind_are_refused(shared: Simulation) -> None:
    nobody = "command: no fleet and no vehicle is called 'alpa'; did you mean 'alpha'?"
    assert said(shared.step, {"alpa": None}) == nobody
    setpoint = VelocitySetpoint.of(np.zeros((5, 3)))
    assert said(shared.step, setpoint) == (
        "command: a VelocitySetpoint is not for WaypointController, which takes WaypointSetpoint; "
        "a controller of type 'offboard' takes it"
    )
    assert said(shared.step, {"bravo": hover()}).startswith("command: expected shape (2, 5)")


@pytest.mark.long
def test_controllers_can_be_fed_with_the_estimate_of_a_users_filter(flying: Simulation) -> None:
    """With an estimate 5 m north of the truth, the vehicles settle 5 m south of where they are asked to be."""
    start, truth = flying.save(), flying.truth
    asked = truth.position_ned + np.array([0.0, 0.0, -1.0])
    for _ in range(400):
        now = flying.truth
        estimate = Estimate.of(now.position_ned + np.array([5.0, 0.0, 0.0]), now.velocity_ned, now.attitude)
        flying.step(flying.waypoint(asked), ticks=2, estimate=estimate)
    offset = flying.truth.position_ned - asked
    np.testing.assert_allclose(offset[:, 0], -5.0, atol=0.3)
    np.testing.assert_allclose(offset[:, 1], 0.0, atol=0.3)
    flying.load(start)
    assert said(flying.step, None, 1, Estimate.of(np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 3)))).startswith(
        "estimate: position_ned.x: expected shape (5,), found shape (4,)"
    )
    assert said(flying.step, None, 1, np.zeros((5, 3))).startswith("estimate: expected a qrsim.Estimate, found ")


@pytest.mark.parametrize("field", COMMAND_FIELDS)
@pytest.mark.parametrize("where", ["below", "above", "nan", "inf", "-inf"])
def test_a_command_out_of_its_range_names_field_value_vehicle_and_range(
    shared: Simulation, field: str, where: str
) -> None:
    low, high = COMMAND_LIMITS[field]
    value = {"below": low - 0.25, "above": high + 0.25}.get(where) or float(where)
    command = hover()
    command[3, COMMAND_FIELDS.index(field)] = value
    before = shared.truth.state
    assert said(shared.step, command) == (
        f"command: {field} of vehicle 3 ('bravo_0') is {value:g}; allowed: {low:g} to {high:g}"
    )
    assert shared.tick == 0
    np.testing.assert_array_equal(shared.truth.state, before)


def test_the_limits_themselves_are_allowed(flying: Simulation) -> None:
    for end in (0, 1):
        flying.reset()
        flying.step(np.tile([COMMAND_LIMITS[field][end] for field in COMMAND_FIELDS], (5, 1)))
        assert flying.tick == 1


@pytest.mark.parametrize("ticks", [0, -1, 1.5, 1.0, True, "3", None, math.nan])
def test_a_number_of_ticks_that_is_no_positive_integer_is_refused(shared: Simulation, ticks: Any) -> None:
    assert said(shared.step, ticks=ticks) == f"ticks: {ticks!r} is not a positive integer"
    assert said(shared.record, ticks) == f"ticks: {ticks!r} is not a positive integer"
    assert shared.tick == 0


def test_the_last_tick_cannot_be_passed(shared: Simulation) -> None:
    assert "would pass the last tick" in said(shared.step, ticks=LARGEST_TICK + 1)
    assert "would pass the last tick" in said(shared.step, ticks=2**40)


def test_a_record_longer_than_its_capacity_is_refused(shared: Simulation) -> None:
    expected = "ticks: 11 is more than the capacity, 10; give capacity=11, or none"
    assert said(shared.record, 11, capacity=10) == expected


def test_a_record_of_any_length_needs_no_capacity(shared: Simulation) -> None:
    shared.reset(seed=1)
    history = shared.record(120)
    assert history.time[-1] == pytest.approx(2.4)
    assert history.state.fleets[0].vehicle.position_ned.x.shape[0] == 120


@pytest.mark.parametrize(
    ("position", "yaw", "expected"),
    [
        ([1.0, 2.0], 0.0, "position_ned: expected numbers of shape (5, 3), found shape (2,)"),
        (np.zeros((4, 3)), 0.0, "position_ned: expected numbers of shape (5, 3), found shape (4, 3)"),
        ("there", 0.0, "position_ned: expected numbers of shape (5, 3), found shape ()"),
        ([[1.0, 2.0, 3.0], [1.0]], 0.0, "position_ned: expected numbers of shape (5, 3), found rows of different"),
        ([1.0, math.nan, 3.0], 0.0, "position_ned: not finite for vehicle 0 ('alpha_0')"),
        (np.where(np.arange(15).reshape(5, 3) == 10, math.inf, 0.0), 0.0, "position_ned: not finite for vehicle 3"),
        ([1.0, 2.0, -3.0], [0.0, 1.0], "yaw_rad: expected numbers of shape (5,), found shape (2,)"),
        ([1.0, 2.0, -3.0], math.nan, "yaw_rad: not finite for vehicle 0 ('alpha_0')"),
        ([1.0, 2.0, -3.0], "north", "yaw_rad: expected numbers of shape (5,), found shape ()"),
    ],
)
def test_a_bad_set_point_is_refused(shared: Simulation, position: Any, yaw: Any, expected: str) -> None:
    assert said(shared.waypoint, position, yaw).startswith(expected)


def test_a_command_record_of_unequal_columns_is_refused(shared: Simulation) -> None:
    columns = [np.zeros(5), np.zeros(5), np.zeros(5), np.zeros(4), np.zeros(5)]
    assert said(shared.step, Command(*columns)).startswith("command: ")


@pytest.mark.parametrize("yaw", [np.zeros(2, np.float32), np.full(1, math.nan, np.float32)], ids=["shape", "nan"])
def test_a_set_point_made_by_hand_is_checked_too(yaw: Any) -> None:
    simulation = qrsim.load("hover_ideal")
    simulation.reset()
    setpoint = simulation.waypoint([0.0, 0.0, -10.0])
    assert "yaw" in said(simulation.step, WaypointSetpoint(setpoint.position_ned, yaw))


class TestSetState:
    """Vehicles put somewhere else between two ticks."""

    def test_vehicles_are_where_they_were_put_and_the_others_are_left_alone(self, flying: Simulation) -> None:
        start, before = flying.save(), flying.truth.state
        rows = np.full((5, 13), np.nan)
        rows[1] = [1.0, 2.0, -15.0, 0.1, -0.1, 0.5, 1.0, 0.0, -0.5, 0.1, 0.2, 0.3, 20.0]
        flying.set_state(rows)
        expected = np.where(np.isnan(rows), before, rows)
        np.testing.assert_array_equal(flying.truth.state, expected.astype(np.float32))
        flying.step(ticks=5)
        assert np.isfinite(flying.truth.state).all()
        flying.load(start)

    @pytest.mark.parametrize("width", [3, 6, 12])
    def test_what_is_left_out_is_at_rest_with_the_thrust_of_hover(self, flying: Simulation, width: int) -> None:
        start = flying.save()
        rows = np.zeros((5, 12))
        rows[:, :3] = [[10.0 * i, 0.0, -20.0] for i in range(5)]
        flying.set_state(rows[:, :width])
        np.testing.assert_array_equal(flying.truth.state[:, :12], rows)
        np.testing.assert_allclose(flying.truth.thrust, 1.68 * 9.81, rtol=1e-6)
        flying.load(start)

    def test_a_stopped_vehicle_flies_again(self, flying: Simulation) -> None:
        start = flying.save()
        command = hover()
        command[0, 2] = 0.0
        while flying.valid.all():
            flying.step(command, ticks=10)
        assert not flying.valid[0]
        rows = np.full((5, 3), np.nan)
        rows[0] = [0.0, 0.0, -20.0]
        flying.set_state(rows)
        assert flying.valid.all()
        flying.step(ticks=20)
        assert np.isfinite(flying.reading["alpha"].gnss.position_ned).all()
        flying.load(start)

    def test_sensors_and_loops_are_those_of_the_new_place_at_once(self, flying: Simulation) -> None:
        """In the middle of the periods of an ideal barometer and an ideal GNSS; the flight goes on from there."""
        start = flying.save()
        flying.step(ticks=4)
        rows = np.zeros((5, 3))
        rows[:, 0], rows[:, 1], rows[:, 2] = 30.0, 10.0 * np.arange(5) - 20.0, -15.0
        reading = flying.set_state(rows)
        np.testing.assert_array_equal(reading["alpha"].gnss.position_ned, rows[:3])
        np.testing.assert_array_equal(reading["alpha"].gnss.velocity_ned, 0.0)
        np.testing.assert_array_equal(reading["alpha"].barometer.height, 15.0)
        np.testing.assert_array_equal(reading["bravo"].height.height, 15.0)
        flying.step(flying.waypoint(rows), ticks=50)
        assert np.abs(flying.truth.attitude).max() < 0.01
        assert np.abs(flying.truth.position_ned - rows).max() < 0.1
        flying.load(start)

    def test_bad_states_are_refused(self, shared: Simulation) -> None:
        assert said(shared.set_state, np.zeros((5, 7))).startswith(
            "state: expected shape (5, 13), 12, 6 or 3 columns, "
        )
        assert said(shared.set_state, "up").startswith("state: expected shape (5, 13)")
        # Numbers that are too large for any type of NumPy.
        assert said(shared.set_state, [[10**400] * 3] * 5).startswith("state: expected shape (5, 13)")
        assert said(shared.step, [[10**400] * 5] * 5).startswith("command: ")
        apart = np.array([[10.0 * i, 0.0, -20.0] for i in range(5)])
        partly = apart.copy()
        partly[2, 1] = np.nan
        assert said(shared.set_state, partly).startswith("state: the row of vehicle 2 ('alpha_2') is partly not finite")
        for row, value, why in [
            (1, [0.0, 60.0, -20.0], "out_of_area: position_ned.y = 60 m"),
            (3, [10.5, 0.0, -20.0], "collision: distance = 0.5 m"),
            (4, [-40.0, 40.0, -10.0], "collision: obstacle 0"),
        ]:
            wrong = apart.copy()
            wrong[row] = value
            first = 1 if row == 3 else row  # The first of two that collide is named.
            expected = f"state: vehicle {first} ('{shared.vehicle_names[first]}') would be invalid: {why}"
            assert said(shared.set_state, wrong) == expected


def test_other_parameters_from_the_next_tick_on() -> None:
    """They count at once; what is no number does not change in flight."""
    simulation = simulate(quiet())
    simulation.reset()
    simulation.step(ticks=5)
    calm = simulation.save()
    simulation.step(ticks=20)
    undisturbed = simulation.truth.state.copy()
    simulation.load(calm)
    fleet = simulation.world.fleets[0]
    heavier = replace(fleet, vehicle=replace(fleet.vehicle, mass=fleet.vehicle.mass * np.float32(1.2)))
    simulation.change_world(replace(simulation.world, fleets=(heavier, *simulation.world.fleets[1:])))
    simulation.step(ticks=20)
    assert (simulation.truth.state[:, 2] > undisturbed[:, 2] + 1e-3).any()
    with pytest.raises(UsageError, match="differs in more than numbers"):
        simulation.change_world(replace(simulation.world, time_step=0.01))
