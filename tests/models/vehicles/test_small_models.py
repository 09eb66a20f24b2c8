"""Numbers of batteries, carried points, paths, faults, wakes and noise of vehicles, against closed forms by hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.models.by_hand import many

from qrsim.core.noise import Drawn
from qrsim.core.tree import cast, record
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.battery import Charge, LithiumPolymer
from qrsim.models.vehicles.carried_point import CarriedPoint
from qrsim.models.vehicles.contracts import Handling, Load, Pose
from qrsim.models.vehicles.faults import RotorFault, failed_rotors
from qrsim.models.vehicles.fixed_point import FixedPoint
from qrsim.models.vehicles.lithium_cells import CellsState, LithiumCells
from qrsim.models.vehicles.moving import move
from qrsim.models.vehicles.no_command import NoCommand
from qrsim.models.vehicles.process_noise import white_accelerations
from qrsim.models.vehicles.recorded_path import PathFile, RecordedPath
from qrsim.models.vehicles.wake import Wake, first_jet_speed

pytestmark = pytest.mark.usefixtures("double_precision")


@pytest.mark.parametrize(
    ("full", "empty", "charge", "load", "voltage"),
    [
        # (V15) of a pack of three cells: 9.9 + 2.1 C, less 0.02 Ohm x 23.4375 A, no lower than 9 V.
        (12.0, 9.9, 0.5, 1.0, 10.95 - 0.46875),
        (12.0, 9.9, 0.0, 4.0, 9.0),
        (12.0, 9.9, 0.0, 1.0, 9.9 - 0.46875),
        # Of others no lower than 0.9375 V_empty, wherever that is.
        (16.8, 13.2, 0.0, 4.0, 12.375),
        (8.4, 6.4, 0.0, 4.0, 6.0),
        (16.8, 13.2, 1.0, 1.0, 16.8 - 0.46875),
    ],
)
def test_where_the_sag_ends(full: float, empty: float, charge: float, load: float, voltage: float) -> None:
    pack: Any = cast(LithiumPolymer(voltage_full=full, voltage_empty=empty), np.float64)  # type: ignore[arg-type]
    found = pack.voltage(Charge(many(charge)), Load(many(16.0 * load ** (2.0 / 3.0)), many(16.0)))
    np.testing.assert_allclose(found, voltage, rtol=1e-9)


def test_rotors_that_stand_take_a_billionth_of_the_hover_current() -> None:
    """(V13) at the least thrust that counts, a millionth of the weight: 1e-6^1.5 of a charge in one endurance."""
    pack: Any = cast(LithiumPolymer(), np.float64)
    for thrust in (0.0, 1e-7, 1e-5):
        left = pack.step(Charge(many(1.0)), Load(many(thrust), many(10.0)), 960.0).charge
        np.testing.assert_allclose(1.0 - left, 1e-9, rtol=1e-6)


def test_a_pack_of_cells_gives_five_amperes() -> None:
    """(V26) at half charge is 15.21345 V; behind 16 milliohm 5 A are 15.13345 V. 36 s take 0.05 Ah of 5 Ah."""
    pack: Any = cast(LithiumCells(), np.float64)
    state = CellsState(many(0.5), many(0.0), many(0.0))
    load = Load(many(20.0), many(20.0), many(5.0 * 15.13345))
    np.testing.assert_allclose(pack.open_circuit(many(0.5)), 15.21345, atol=2e-7)
    np.testing.assert_allclose(pack.voltage(state, load), 15.13345, atol=2e-7)
    after = pack.step(state, load, 36.0)
    np.testing.assert_allclose(after.charge, 0.49, atol=1e-9)
    np.testing.assert_allclose(after.current, 5.0, atol=1e-6)
    # The most is OCV^2/(4 r), 3616.4 W.
    for power, asked in ((3600.0, 0.0), (3630.0, 3630.0)):
        assert float(pack.step(state, Load(many(20.0), many(20.0), many(power)), 0.02).overload[0]) == asked


def path(seconds: list[int], *rows: Any) -> RecordedPath:
    """Return a path along north and east: north, its slope, heading, its slope; east is 0.5 north."""
    north, speed, heading, rate = (many(*row) for row in rows)
    place, velocity = Vec3(north, 0.5 * north, -north), Vec3(speed, 0.5 * speed, -speed)
    whole = jnp.asarray(seconds, jnp.int32)
    return RecordedPath(whole, jnp.zeros(len(seconds)), place, velocity, heading, rate)


def test_a_path_follows_the_cubic_of_its_rows_and_rests_beyond_them() -> None:
    """North t^3 - 2 t^2 + 3 t and heading 2 - t^3/8, rows at 0, 2 and 4 s: a cubic is met with its slope."""
    rows: tuple[Any, ...] = ([0.0, 6.0, 44.0], [3.0, 7.0, 35.0], [2.0, 1.0, -6.0], [0.0, -1.5, -6.0])
    times = np.array([0.0, 0.25, 0.5, 1.5, 1.75, 2.25, 3.0, 3.5, 3.9375, 4.25, 6.5, -0.5])
    whole = np.floor(times).astype(np.int32)
    found = jax.jit(jax.vmap(path([0, 2, 4], *rows).at))(jnp.asarray(whole), jnp.asarray(times - whole))
    t, within = np.clip(times, 0.0, 4.0), (times >= 0.0) & (times <= 4.0)
    north, speed = t**3 - 2.0 * t**2 + 3.0 * t, within * (3.0 * t**2 - 4.0 * t + 3.0)
    np.testing.assert_allclose(found.position_ned.axes, [north, 0.5 * north, -north], atol=1e-12)
    np.testing.assert_allclose(found.velocity_ned.axes, [speed, 0.5 * speed, -speed], atol=1e-12)
    np.testing.assert_allclose(found.heading, 2.0 - t**3 / 8.0, atol=1e-12)
    np.testing.assert_allclose(found.turn_rate, within * -0.375 * t**2, atol=1e-12)


def test_a_file_of_a_cubic_is_that_cubic(tmp_path: Path) -> None:
    """Five rows of north t^3: a spline through a cubic is the cubic, its slopes 3 t^2; a heading that turns evenly."""
    file = tmp_path / "cubic.csv"
    lines = [f"{t},{t**3},{2 * t},0,{20 * t}" for t in range(5)]
    file.write_text("\n".join(["time,north,east,down,heading_deg", *lines, ""]))
    found = PathFile(file=str(file)).at(4.0)
    np.testing.assert_allclose(found.velocity_ned.x, [0.0, 3.0, 12.0, 27.0, 48.0], atol=1e-9)
    np.testing.assert_allclose(found.velocity_ned.y, 2.0, atol=1e-9)
    np.testing.assert_allclose(found.turn_rate, math.radians(20.0), atol=1e-9)


def test_a_turn_is_felt_to_the_side_alone() -> None:
    """In a step of 1 s on a circle at 4 m/s by 0.5 rad the velocity changes by 2 x 4 sin(0.25), at the mean heading."""
    turn = 0.5
    radius = 4.0 / turn
    sine, cosine = math.sin(turn), math.cos(turn)
    place = Vec3(many(0.0, radius * sine), many(0.0, radius * (1.0 - cosine)), many(0.0, 0.0))
    velocity = Vec3(many(4.0, 4.0 * cosine), many(0.0, 4.0 * sine), many(0.0, 0.0))
    seconds = jnp.asarray([0, 1], jnp.int32)
    circle = RecordedPath(seconds, jnp.zeros(2), place, velocity, many(0.0, turn), many(turn, turn))
    point: Any = CarriedPoint(circle)
    zero = Vec3(many(0.0), many(0.0), many(0.0))

    @jax.jit
    def step(at: Vec3) -> Any:
        start = point.initial_state(at, Euler(*zero.axes), zero, zero)
        return point.step(start, NoCommand(), lambda trig: zero, None, 1.0)

    after, force = step(zero)
    np.testing.assert_allclose([axis[0] for axis in force.axes], [0.0, 8.0 * math.sin(0.25), -9.81], atol=1e-12)
    np.testing.assert_allclose(after.position_ned.x, radius * sine, atol=1e-12)


def test_who_has_no_thrust_counts_as_one_that_hovers() -> None:
    load = Load(many(5.0, math.nan, 4.0), many(4.0, 4.0, 0.0))
    assert load.per_weight(many(0.0, 0.0, 0.0)).tolist() == [1.25, 1.0, 1.0]
    assert FixedPoint().upright_share(NoCommand()) == 1.0


def test_the_throttle_of_a_curve_is_the_root_of_its_polynomial() -> None:
    """1 + 2 u + 3 u^2 = 2.75 at 0.5. A curve that hardly rises counts as one that rises by a micronewton."""
    one = many(1.0)

    def throttle(curve: tuple[float, ...], thrust: float) -> float:
        told = Handling(one, one, one, tuple(many(c) for c in curve), one, one, one)
        return float(told.throttle(many(thrust))[0])

    assert throttle((1.0, 2.0, 3.0), 2.75) == pytest.approx(0.5, rel=1e-12)
    assert throttle((0.0, 0.0, 0.0), 0.25e-6) == pytest.approx(0.5, rel=1e-9)


def test_a_rotor_without_a_fault_turns_as_fast_as_it_is_told() -> None:
    """A fault of the second of two vehicles from tick 10 to 20, of which the autopilot knows 5 ticks later."""
    ticks = (jnp.int32(10), jnp.int32(5), jnp.int32(20))
    fault = RotorFault(*ticks, jnp.asarray([False, True]), jnp.asarray(0.3), 2)
    for tick, health, known in (
        (9, [1.0, 1.0], [False, False]),
        (10, [1.0, 0.3], [False, False]),
        (15, [1.0, 0.3], [False, True]),
        (19, [1.0, 0.3], [False, True]),
        (20, [1.0, 1.0], [False, False]),
    ):
        ((rotor, left, knows),) = failed_rotors((fault,), jnp.int32(tick))
        assert rotor == 2
        assert left.tolist() == health
        assert knows.tolist() == known


@record
class Sliding:
    """Where something is, and how fast it goes north; each (n,)."""

    position_ned: Vec3
    speed: Any


class Slider:
    """Something that slides on the ground it looks at, 0.03 m in a step from 1 to 2 m/s."""

    reads = ("ground",)

    def pose(self, state: Sliding) -> Pose:
        zero = 0.0 * state.speed
        still = Vec3(zero, zero, zero)
        return Pose(state.position_ned, Euler(zero, zero, zero), Vec3(state.speed, zero, zero), still)

    def step(self, state: Sliding, *rest: Any) -> tuple[Sliding, Vec3]:
        at = state.position_ned
        return Sliding(Vec3(at.x + np.float32(0.03), at.y, at.z), state.speed + 1), at


def test_a_way_far_out_is_that_of_the_mean_velocity() -> None:
    """At 40 km a single-precision position is known to 4 mm; 1.5 m/s for 20 ms, by both parts together, is 30 mm."""
    one = jnp.ones(1, jnp.float32)
    zero = Vec3(0.0 * one, 0.0 * one, 0.0 * one)
    vehicle, start = Slider(), Sliding(Vec3(40000.0 * one, 0.0 * one, 0.0 * one), one)
    moved, low, _ = move(vehicle, start, zero, None, lambda trig: zero, None, 0.02)  # type: ignore[arg-type]
    assert low is not None
    gone = (np.float64(moved.position_ned.x[0]) - 40000.0) + np.float64(low.x[0])
    assert gone == pytest.approx(0.03, abs=1e-6)


def test_the_noise_of_a_quarter_of_the_step_is_twice_as_large() -> None:
    """(V11): sigma sqrt(0.02 s / T), six normals, linear before angular."""
    normals = Drawn(tuple(many(value) for value in (1.0, -2.0, 3.0, 0.5, -0.25, 0.125)))
    found = white_accelerations(normals, 0.2, 0.005)
    np.testing.assert_allclose([axis[0] for axis in found.linear.axes], [0.4, -0.8, 1.2], rtol=1e-12)
    np.testing.assert_allclose([axis[0] for axis in found.angular.axes], [0.2, -0.1, 0.05], rtol=1e-12)


@pytest.mark.parametrize(("z", "speed"), [(0.01, 6.0), (0.0005, 60.0), (0.002, 30.0)])
def test_a_jet_begins_a_millimetre_below(z: float, speed: float) -> None:
    """The first law of a disc of 1e-9 m^2, whose exhaust is far faster, where 6 sqrt(4 T/(rho pi)) is 0.06."""
    push = 1.225 * math.pi * 0.01**2 / 4.0
    found = first_jet_speed(Wake(many(0.4), many(1e-9)), many(push), many(z), many(0.0))
    np.testing.assert_allclose(found, speed, rtol=1e-9)
