"""The identified quadrotor against golden trajectories, recordings, its paper's facts and numerical analysis."""

from __future__ import annotations

import dataclasses
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from evidence import recordings as study

from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.models.vehicles.quadrotor import (
    COMMAND_FIELDS,
    COMMAND_LIMITS,
    THROTTLE_RAW_PER_UNIT,
    Command,
    Quadrotor,
    QuadrotorState,
    raw_to_command,
)
from qrsim.simulation.openloop import hover_state, simulate_open_loop

Array = np.ndarray[Any, Any]
# Root of the thrust curve at 1.68 kg.
HOVER_THROTTLE = 0.59004353932
DT = 0.02
F32, F64 = jnp.dtype(jnp.float32), jnp.dtype(jnp.float64)
# Columns of the rows of simulate_open_loop.
PHI, THETA, U, P, Q, R, THRUST, FORCE = 3, 4, 6, 9, 10, 11, 12, slice(13, 16)


def hold(steps: int = 500, **values: float) -> Array:
    """(steps, 5) SI commands: hover with the named fields changed. One length for most tests: one compilation."""
    fields = {"pitch": 0.0, "roll": 0.0, "throttle": HOVER_THROTTLE, "yaw_rate": 0.0, "battery": 11.0} | values
    return np.tile(list(fields.values()), (steps, 1))


def relative_error(found: Array, golden: Array) -> float:
    """Largest |a - b| / max(|b|, s) over all elements, s the root mean square of b's column.

    The scale keeps an element that passes through zero from counting infinitely; a column that is zero throughout
    (s = 0) must be met exactly.
    """
    scale = np.maximum(np.abs(golden), np.sqrt(np.mean(golden**2, axis=0)))
    difference = np.abs(found - golden)
    return float(np.max(np.where(difference == 0.0, 0.0, difference / np.where(scale > 0.0, scale, 1e-300))))


def rounds_to(value: float, stated: str) -> bool:
    """Whether a number, rounded to as many significant digits as the text shows, is the text."""
    digits = len(stated.partition("e")[0].replace(".", "").lstrip("0"))
    return float(f"{value:.{digits - 1}e}") == float(stated)


@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-9), ("float32", 1e-4)])
@pytest.mark.parametrize("name", ["hover", "varied"])
def test_golden_trajectory(golden: Path, name: str, precision: str, tolerance: float):
    rows = np.loadtxt(golden / f"{name}.csv", delimiter=",", skiprows=1)
    vehicle = Quadrotor()
    states = simulate_open_loop(
        vehicle,
        study.command_rows(*rows[:, 1:6].T),
        hover_state(vehicle),
        wind_body=(1.0, -0.5, 0.2),
        dt=DT,
        precision=precision,
    )
    assert states.shape == (500, 16)
    assert states.dtype == precision
    assert relative_error(states, rows[:, 6:]) < tolerance


class TestRecordings:
    """Every number of docs/explanation/paper.md on recordings, and the specific forces, to the digits there."""

    STATED = (
        ("rotation.phi", "6.563e-4"),
        ("rotation.theta", "8.355e-4"),
        ("rotation.psi", "1.755e-2"),
        ("rotation.p", "2.478e-2"),
        ("rotation.q", "1.872e-2"),
        ("rotation.r", "2.867e-2"),
        ("thrust.mean_squared_error", "0.9817"),
        ("thrust.record_variance", "73.9"),
        ("outdoor_velocity.north", "3.736"),
        ("outdoor_velocity.east", "2.389"),
        ("outdoor_velocity.down", "1.547"),
        ("specific_force.ours.x", "0.63"),
        ("specific_force.ours.y", "0.36"),
        ("specific_force.ours.z", "3.05"),
        ("specific_force.reference.x", "0.76"),
        ("specific_force.reference.y", "0.47"),
        ("specific_force.reference.z", "4.33"),
    )

    def test_mean_squared_errors(self, recordings: Path):
        results = study.run(full=False, folder=recordings)
        wrong = []
        for path, stated in self.STATED:
            value: Any = results
            for part in path.split("."):
                value = value[part]
            if not rounds_to(value, stated):
                wrong.append(f"{path}: {value} is not {stated}")
        assert not wrong


class TestFacts:
    def test_hover_throttle_carries_the_weight(self):
        vehicle = Quadrotor()
        raw = HOVER_THROTTLE * THROTTLE_RAW_PER_UNIT
        thrust = vehicle.cth0 + vehicle.cth1 * raw + vehicle.cth2 * raw**2
        assert thrust == pytest.approx(1.68 * 9.81, rel=1e-10)
        assert rounds_to(HOVER_THROTTLE, "0.5900435393")
        states = simulate_open_loop(vehicle, hold(), hover_state(vehicle))
        np.testing.assert_allclose(states[-1, :3], [0.0, 0.0, -10.0], atol=1e-6)
        np.testing.assert_allclose(states[:, FORCE], np.tile([0.0, 0.0, -9.81], (500, 1)), atol=1e-8)

    @pytest.mark.parametrize(
        ("battery", "thrust"), [(9.0, "20.137"), (11.0, "28.612"), (12.0, "32.850"), (20.0, "43.975")]
    )
    def test_largest_thrust(self, battery: float, thrust: str):
        # 20 V lifts the battery's ceiling above what full throttle asks for.
        vehicle = Quadrotor()
        states = simulate_open_loop(vehicle, hold(throttle=1.0, battery=battery), hover_state(vehicle))
        assert rounds_to(states[-1, THRUST], thrust)

    @pytest.mark.parametrize(("field", "column"), [("pitch", THETA), ("roll", PHI)])
    def test_tilt_settles_below_the_command(self, field: str, column: int):
        vehicle = Quadrotor()
        states = simulate_open_loop(vehicle, hold(**{field: 0.2}), hover_state(vehicle))
        assert rounds_to(states[-1, column] / 0.2, "0.74498")

    def test_yaw_rate_settles_below_the_command(self):
        vehicle = Quadrotor()
        states = simulate_open_loop(vehicle, hold(yaw_rate=1.0), hover_state(vehicle))
        assert rounds_to(states[-1, R], "0.43580")

    def test_modes_of_the_attitude_loop(self):
        """Eigenvalues of the slope's Jacobian at hover."""
        with jax.enable_x64(True):
            vehicle = cast(Quadrotor(), F64)

            def slope(x: jax.Array) -> jax.Array:
                state = unflat(jnp.concatenate([jnp.zeros(3), x[:3], jnp.zeros(3), x[3:], jnp.asarray([1.68 * 9.81])]))
                change, _ = vehicle.derivative(state, level(F64), no_wind, no_noise(F64), DT)
                return jnp.stack(jax.tree.leaves((change.attitude, change.rates_body)))

            jacobian = np.asarray(jax.jit(jax.jacfwd(slope))(jnp.zeros(6)))
        for pair in ([0, 3], [1, 4]):
            poles = np.linalg.eigvals(jacobian[np.ix_(pair, pair)])
            frequency = math.sqrt(abs(np.prod(poles)))
            assert rounds_to(frequency, "13.41")
            assert rounds_to(-np.sum(poles).real / (2.0 * frequency), "0.908")
        assert rounds_to(-1.0 / jacobian[5, 5], "0.1965")


def unflat(x: Any) -> QuadrotorState:
    return QuadrotorState(Vec3(*x[:3]), Euler(*x[3:6]), Vec3(*x[6:9]), Vec3(*x[9:12]), x[12])


def level(dtype: Any, **values: float) -> Command:
    return Command(*(jnp.asarray(value, dtype) for value in hold(1, **values)[0]))


def no_wind(trig: AttitudeTrig) -> Vec3:
    return Vec3.zeros(trig.sin_roll.shape, trig.sin_roll.dtype)


def no_noise(dtype: Any, shape: tuple[int, ...] = ()) -> ProcessNoise:
    return ProcessNoise(Vec3.zeros(shape, dtype), Vec3.zeros(shape, dtype))


class TestThrust:
    @pytest.mark.parametrize(
        ("thrust", "throttle", "battery", "expected"),
        [
            (16.0, 0.0, 11.0, 3.07321 * (0.663881 - 16.0)),  # idling rotors follow slowly, however far they are
            (16.4, HOVER_THROTTLE, 11.0, (1.68 * 9.81 - 16.4) / DT),  # within one step: there in one step
            (10.0, 1.0, 11.0, 46.8004),
            (30.0, 0.4, 11.0, -46.8004),
            (20.0, 1.0, 9.0, (4.23754 * 9.0 - 18.0007 - 20.0) / DT),  # up to the battery's ceiling
            (30.0, 1.0, 9.0, -46.8004),  # and down to it, at the same limited rate
        ],
    )
    def test_rate(self, thrust: float, throttle: float, battery: float, expected: float):
        rate = Quadrotor().thrust_rate(np.float64(thrust), np.float64(throttle), np.float64(battery), DT)  # type: ignore[arg-type]
        # Evaluated in single precision, whose rounding of the thrust counts 1/T times.
        assert float(rate) == pytest.approx(expected, rel=1e-5, abs=2e-4)

    def test_battery_ceiling_is_reached_at_the_limited_rate(self):
        vehicle = Quadrotor()
        commands = np.concatenate([hold(250, throttle=1.0, battery=12.0), hold(250, throttle=1.0, battery=9.0)])
        thrust = simulate_open_loop(vehicle, commands, hover_state(vehicle))[:, THRUST]
        assert rounds_to(thrust[249], "32.850")
        assert np.max(np.abs(np.diff(thrust))) <= vehicle.tau1 * DT * (1.0 + 1e-12)
        # 12.713 N at 0.936 N per step: twelve steps at the limit, then Heun's second stage sees the end coming.
        np.testing.assert_allclose(-np.diff(thrust[249:262]), vehicle.tau1 * DT, rtol=1e-9)
        assert rounds_to(thrust[-1], "20.137")


class TestRateLimit:
    def test_holds_a_rate_near_the_limit(self):
        vehicle = Quadrotor()
        rates = simulate_open_loop(vehicle, hold(roll=0.9, pitch=-0.9), hover_state(vehicle))[:, [P, Q]]
        # The last free step may pass the limit by half of one step's change: the second stage sees it.
        step = vehicle.kpq1 * vehicle.kpq0 * 0.9 / -math.radians(0.025) * DT
        assert vehicle.rate_max < np.max(rates[:, 0]) < vehicle.rate_max + step
        assert -vehicle.rate_max > np.min(rates[:, 1]) > -vehicle.rate_max - step

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    @pytest.mark.parametrize(("field", "column"), [("roll", P), ("pitch", Q)])
    def test_freezes_nothing(self, field: str, column: int, sign: float):
        """A rate beyond the limit comes down under a command that opposes it, and then settles."""
        vehicle = Quadrotor()
        start = hover_state(vehicle)
        start[column] = sign * 1.2 * vehicle.rate_max
        states = simulate_open_loop(vehicle, hold(**{field: -0.2 * sign}), start)
        rate = sign * states[:, column]
        assert np.all(rate[1:5] < rate[:4])
        assert rate[5] < 0.8 * vehicle.rate_max
        assert abs(rate[-1]) < 1e-3

    def test_stops_only_what_points_outward(self):
        with jax.enable_x64(True):
            vehicle = cast(Quadrotor(), F64)
            rate = jnp.asarray([3.0, 3.0, -3.0, -3.0, 2.6, -2.6])
            acceleration = jnp.asarray([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
            limited = vehicle._rate_limited(acceleration, rate)
        np.testing.assert_array_equal(limited, [0.0, -1.0, 1.0, 0.0, 1.0, -1.0])


class TestProcessNoise:
    def test_standard_deviation_scales_with_the_step(self):
        ids = jnp.arange(20_000, dtype=jnp.uint32)
        draw = Draw(Key.root(1).stream("process", ids), jnp.uint32(0), jnp.zeros((), F32))
        steps = (0.02, 0.005, 0.1)
        drawn = jax.jit(lambda draw: [Quadrotor().draw_noise(draw, dt) for dt in steps])(draw)
        reference = jax.tree.leaves(drawn[0])
        assert len(reference) == 6
        for axis in reference:
            # 99.9 % over six axes: 3.76 standard errors of a standard deviation, 1/sqrt(2 n).
            assert float(jnp.std(axis)) == pytest.approx(0.2, rel=3.76 / math.sqrt(2 * 20_000))
        for dt, scaled in zip(steps[1:], drawn[1:], strict=True):
            for axis, base in zip(jax.tree.leaves(scaled), reference, strict=True):
                np.testing.assert_allclose(axis, base * math.sqrt(0.02 / dt), rtol=1e-6)

    @pytest.mark.long
    def test_motion_does_not_depend_on_the_step(self):
        """The spread of 4096 vehicles after 0.4 s, at four times the steps."""
        n = 4096
        ids = jnp.arange(n, dtype=jnp.uint32)

        def spread(dt: float) -> Array:
            vehicle = cast(Quadrotor(), F32)
            stream = Key.root(2).stream(f"process {dt}", ids)
            zero = Vec3.zeros((n,), F32)
            start = vehicle.initial_state(zero, Euler(zero.x, zero.y, zero.z), zero, zero)
            command = jax.tree.map(lambda x: jnp.full(n, x), level(F32))

            def tick(state: QuadrotorState, now: jax.Array) -> tuple[QuadrotorState, None]:
                noise = vehicle.draw_noise(Draw(stream, now, jnp.zeros((), F32)), dt)
                return vehicle.step(state, command, no_wind, noise, dt)[0], None

            end = jax.jit(lambda s: jax.lax.scan(tick, s, jnp.arange(round(0.4 / dt), dtype=jnp.uint32))[0])(start)
            return np.array([np.std(leaf) for leaf in jax.tree.leaves((end.velocity_body, end.rates_body))])

        # 99.9 % over six ratios (3.76 standard errors, 1/sqrt(n) each), and 5 % for the integrator at 0.02 s, whose
        # step is half the rates' time constant. Noise that did not scale would be off by a factor of two.
        np.testing.assert_allclose(spread(0.005) / spread(0.02), 1.0, atol=3.76 / math.sqrt(n) + 0.05)

    def test_an_accelerometer_feels_it(self):
        with jax.enable_x64(True):
            vehicle = cast(Quadrotor(), F64)
            push = Vec3(*(jnp.asarray(x) for x in (0.3, -0.2, 0.1)))
            noise = ProcessNoise(push, Vec3.zeros((), F64))
            state = unflat(jnp.asarray(hover_state(Quadrotor())))
            slope, force = jax.jit(lambda s, n: vehicle.derivative(s, level(F64), no_wind, n, DT))(state, noise)
        np.testing.assert_allclose(force.stack(), [0.3, -0.2, 0.1 - 9.81], atol=1e-9)
        np.testing.assert_allclose(slope.velocity_body.stack(), [0.3, -0.2, 0.1], atol=1e-9)


@lru_cache
def smooth_flight(integrator: Any, dt: float) -> Array:
    """State (13,) after 0.72 s of three held tilts."""
    tilts = ((0.2, -0.1, 0.5), (-0.1, 0.15, -1.0), (0.0, 0.05, 0.0))
    each = round(0.24 / dt)
    commands = np.concatenate([hold(each, pitch=a, roll=b, yaw_rate=c) for a, b, c in tilts])
    vehicle = replace(Quadrotor(), integrator=integrator)
    rows = simulate_open_loop(vehicle, commands, hover_state(vehicle), wind_body=(1.0, -0.5, 0.2), dt=dt)
    return rows[-1, :13]


class TestNumerics:
    @pytest.mark.parametrize(("integrator", "order"), [("heun", 2), ("rk4", 4)])
    @pytest.mark.long
    def test_converges_with_the_step(self, integrator: Any, order: int):
        """Held commands below the rate limit at constant thrust, where the slope is smooth."""
        exact = smooth_flight("rk4", 0.001)
        coarse, fine = (np.linalg.norm(smooth_flight(integrator, dt) - exact) for dt in (0.008, 0.004))
        assert math.log2(coarse / fine) == pytest.approx(order, abs=0.3)
        assert fine < 1e-3

    @pytest.mark.parametrize("precision", ["float32", "float64"])
    @pytest.mark.long
    def test_gradient_with_respect_to_every_constant(self, precision: str):
        """Finite throughout; in float64 also equal to central differences."""
        rng = np.random.default_rng(3)
        held = np.repeat(rng.uniform(*zip(*COMMAND_LIMITS.values(), strict=True), (8, 5)), 5, axis=0)
        # Touch every branch: idle rotors, the battery's ceiling, the rate limit.
        held[:5, 2], held[10:20, 2], held[10:20, 4], held[20:25, 1] = 0.01, 1.0, 9.0, 0.9
        with jax.enable_x64(precision == "float64"):
            dtype = jnp.dtype(precision)
            weights = jnp.asarray(rng.normal(size=16), dtype)
            start = unflat(jnp.asarray(hover_state(Quadrotor()), dtype))
            wind = Vec3(*jnp.asarray([1.0, -0.5, 0.2], dtype))
            # One draw per step, as if each step were a vehicle of its own: fewer lines to differentiate.
            stream = Key.root(4).stream("process", jnp.arange(len(held), dtype=jnp.uint32))
            draw = Draw(stream, jnp.uint32(0), jnp.zeros((), dtype))

            def score(vehicle: Quadrotor) -> jax.Array:
                def tick(state: QuadrotorState, inputs: Any) -> tuple[QuadrotorState, jax.Array]:
                    row, noise = inputs
                    state, force = vehicle.step(state, Command(*row), lambda trig: wind, noise, DT)
                    return state, jnp.stack(jax.tree.leaves((state, force)))

                inputs = (jnp.asarray(held, dtype), vehicle.draw_noise(draw, DT))
                return jnp.mean(jax.lax.scan(tick, start, inputs)[1] @ weights)

            vehicle = jax.tree.map(lambda x: jnp.asarray(x, dtype), cast(Quadrotor(), dtype))
            evaluate = jax.jit(jax.value_and_grad(score))
            _, gradient = evaluate(vehicle)
            names = [f.name for f in dataclasses.fields(Quadrotor) if f.name not in ("integrator", "downwash")]
            assert len(names) == 19
            found = {name: float(getattr(gradient, name)) for name in names}
            assert all(math.isfinite(value) for value in found.values()), found
            # Two constants only choose a branch.
            switches = {"throttle_min_raw", "rate_max"}
            assert {name for name, value in found.items() if value == 0.0} == switches
            if precision == "float64":
                for name in names:
                    value = float(getattr(vehicle, name))
                    h = 1e-6 * abs(value)
                    moved = [replace(vehicle, **{name: jnp.asarray(value + s * h, dtype)}) for s in (1, -1)]
                    numeric = (float(evaluate(moved[0])[0]) - float(evaluate(moved[1])[0])) / (2.0 * h)
                    assert found[name] == pytest.approx(numeric, rel=1e-5, abs=1e-8), name


class TestStep:
    @pytest.mark.long
    def test_vehicles_do_not_touch_each_other(self):
        """Five different vehicles in one call, and each alone, in one precision, to the last bits."""
        rng = np.random.default_rng(5)
        with jax.enable_x64(True):
            states = unflat(jnp.asarray(rng.normal(size=(13, 5)) + np.eye(13)[12][:, None] * 15.0))
            low, high = (np.array(side)[:, None] for side in zip(*COMMAND_LIMITS.values(), strict=True))
            commands = Command(*jnp.asarray(rng.uniform(low, high, (5, 5))))
            vehicle = cast(replace(Quadrotor(), mass=np.linspace(1.0, 2.0, 5)), F64)
            step = jax.jit(lambda v, s, c: v.step(s, c, no_wind, no_noise(F64, c.pitch.shape), DT))
            together = step(vehicle, states, commands)
            for i in range(5):
                state, command = jax.tree.map(lambda x, i=i: x[i : i + 1], (states, commands))
                alone = step(replace(vehicle, mass=vehicle.mass[i : i + 1]), state, command)
                for one, all_ in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
                    np.testing.assert_allclose(one, all_[i : i + 1], rtol=1e-14, atol=1e-14)

    def test_drifts_with_the_wind(self):
        """Air velocity is asked for at each attitude; a level vehicle ends up moving with the air, as it turns."""
        with jax.enable_x64(True):
            vehicle, air = cast(Quadrotor(), F64), Vec3(*jnp.asarray([3.0, -2.0, 0.0]))

            def tick(state: QuadrotorState, _: None) -> tuple[QuadrotorState, None]:
                def wind(trig: AttitudeTrig) -> Vec3:
                    return trig.rotation().to_body(air)

                return vehicle.step(state, level(F64, yaw_rate=1.0), wind, no_noise(F64), DT)[0], None

            end, _ = jax.lax.scan(tick, unflat(jnp.asarray(hover_state(Quadrotor()))), None, 1500)
            velocity = AttitudeTrig.of(end.attitude).rotation().to_ned(end.velocity_body)
        assert float(end.attitude.yaw) > 2.0 * math.pi
        # Heun's rule turns the velocity and the body apart by some 1e-6 rad per step.
        np.testing.assert_allclose(velocity.stack(), [3.0, -2.0, 0.0], atol=1e-3)

    def test_free_fall_reaches_the_terminal_speed(self):
        vehicle = replace(Quadrotor(), cth0=0.0)
        states = simulate_open_loop(vehicle, hold(throttle=0.0), np.zeros(13))
        # Without thrust the drag alone carries: Kw w = -g, and the accelerometer reads one g upward. After 10 s
        # exp(Kw t) = 1.3e-6 of it is missing.
        assert states[-1, 8] == pytest.approx(9.81 / 1.35341, rel=2e-6)
        np.testing.assert_allclose(states[-1, FORCE], [0.0, 0.0, -9.81], atol=2e-5)

    def test_initial_state_carries_the_weight_of_each_vehicle(self):
        zero = Vec3.zeros((2,), F32)
        vehicle = replace(Quadrotor(), mass=jnp.asarray([1.0, 2.0], F32))
        state = vehicle.initial_state(zero, Euler(zero.x, zero.y, zero.z), zero, zero)
        np.testing.assert_allclose(state.thrust, [9.81, 19.62], rtol=1e-7)
        assert Quadrotor().initial_state(zero, Euler(zero.x, zero.y, zero.z), zero, zero).thrust.shape == (2,)


class TestCommands:
    def test_raw_units(self):
        raw = [np.array([x]) for x in (400.0, -400.0, 4097.0, 2047.0, 11.0)]
        command = raw_to_command(*raw)  # type: ignore[arg-type]
        assert float(command.pitch[0]) == pytest.approx(-math.radians(10.0))
        assert float(command.roll[0]) == pytest.approx(math.radians(10.0))
        assert float(command.throttle[0]) == pytest.approx(1.0)
        assert float(command.yaw_rate[0]) == pytest.approx(-math.radians(254.760))
        assert float(command.battery[0]) == 11.0

    def test_clipping_flags_the_vehicles_it_changed(self):
        given = Command(*jnp.asarray(hold(4).T, F32))
        given = replace(given, pitch=jnp.asarray([0.0, 1.0, 0.9, -0.9], F32), battery=jnp.asarray([11, 11, 12, 8], F32))
        clipped, changed = Quadrotor().clip(given)
        np.testing.assert_array_equal(changed, [False, True, False, True])
        np.testing.assert_allclose(clipped.pitch, [0.0, 0.9, 0.9, -0.9])
        np.testing.assert_allclose(clipped.battery, [11.0, 11.0, 12.0, 9.0])
        np.testing.assert_array_equal(clipped.throttle, given.throttle)

    def test_the_voltage_of_a_battery_is_not_clipped(self):
        given = Command(*jnp.asarray(hold(2).T, F32))
        powered = Quadrotor().powered(replace(given, battery=jnp.zeros(2)), jnp.asarray([14.8, 8.0], F32))
        clipped, changed = Quadrotor().clip(powered, powered=True)
        np.testing.assert_allclose(clipped.battery, [14.8, 8.0])
        np.testing.assert_array_equal(changed, [False, False])
        assert Quadrotor().powered(given, None) is given

    def test_a_command_says_its_fields_and_their_limits(self):
        assert COMMAND_FIELDS == ("pitch", "roll", "throttle", "yaw_rate", "battery")
        assert COMMAND_LIMITS == {
            "pitch": (-0.9, 0.9), "roll": (-0.9, 0.9), "throttle": (0.0, 1.0), "yaw_rate": (-4.5, 4.5),
            "battery": (9.0, 12.0),
        }  # fmt: skip
