"""Parameter sets, usual arrangements, and multirotors of six numbers: what is derived, and that it flies so."""

from __future__ import annotations

import math
import re
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3
from qrsim.errors import UsageError
from qrsim.models.atmosphere.standard import SiteAir
from qrsim.models.vehicles.contracts import Around
from qrsim.models.vehicles.multirotor import AttitudeCommand, Multirotor
from qrsim.models.vehicles.multirotor.derived import derived
from qrsim.models.vehicles.multirotor.own import SIX, own_multirotor, rotors_of
from qrsim.models.vehicles.multirotor.sets import SETS
from qrsim.models.vehicles.process_noise import ProcessNoise

QUAD = {
    "mass": 1.2,
    "arm": 0.225,
    "rotors": 4,
    "hover_throttle": 0.5,
    "thrust_to_weight": 2.2,
    "attitude_bandwidth": 8.0,
}
OTHERS = [
    QUAD,
    dict(zip(SIX, (4.0, 0.45, 6, 0.55, 2.0, 6.0), strict=True)),
    dict(zip(SIX, (0.6, 0.12, 4, 0.25, 5.0, 12.0), strict=True)),
    dict(zip(SIX, (9.0, 0.6, 8, 0.5, 2.0, 4.0), strict=True)),
]


def test_a_quadrotor_by_the_rules_of_thumb() -> None:
    """By hand from the rules in docs/explanation/models/multirotor.md, with R = 0.6 of the arm and 1.225 kg/m^3."""
    found = own_multirotor(**QUAD)
    numbers = {
        "mass": 1.2, "inertia_x": 0.0139725, "inertia_y": 0.0139725, "inertia_z": 0.02612250, "rotor_radius": 0.135,
        "thrust_coefficient": 1.597832e-5, "torque_ratio": 0.01641952, "speed_max": 636.5623, "spin_up": 0.0162,
        "spin_down": 0.0324, "rotor_drag": 2.097070e-4, "inflow_loss": 3.742806e-4, "throttle_curve": 0.1818182,
        "drag_x": 0.018604688, "drag_z": 0.037209375, "efficiency": 0.8,
    }  # fmt: skip
    for name, value in numbers.items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-6), name
    assert (found.stabiliser.attitude_gain, found.stabiliser.rate_gain) == (8.0, 24.0)
    # What was asked for comes out again.
    told = derived(found)
    assert told["hover_throttle"] == pytest.approx(0.5, rel=1e-9)
    assert told["thrust_to_weight"] == pytest.approx(2.2, rel=1e-9)
    assert told["roll_time_constant_s"] == 0.125
    assert told["hover_speed_rad_s"] == pytest.approx(429.1702, rel=1e-6)


def test_whatever_is_known_better_replaces_what_is_derived() -> None:
    found = own_multirotor(**QUAD, inertia_x=0.02, spin_up=0.01)
    assert (found.inertia_x, found.spin_up, found.spin_down) == (0.02, 0.01, 0.02)
    with pytest.raises(UsageError, match=r"no such parameter 'inertia'; did you mean 'inertia_[xyz]'\?"):
        own_multirotor(**QUAD, inertia=0.02)


def test_what_is_known_of_the_thrust_keeps_the_declared_thrust_to_weight() -> None:
    """TW m g = N k_T W^2: 2.2 x 1.2 kg x 9.81 m/s^2 / (4 x 3e-5) = 464.56^2."""
    assert own_multirotor(**QUAD, thrust_coefficient=3e-5).speed_max == pytest.approx(464.56, rel=1e-4)
    # k_T goes with the fourth power of the radius.
    wide = own_multirotor(**QUAD, rotor_radius=0.162, spin_up=0.0162)
    assert wide.thrust_coefficient == pytest.approx(1.597832e-5 * 1.2**4, rel=1e-6)
    assert derived(wide)["thrust_to_weight"] == pytest.approx(2.2, rel=1e-9)
    with pytest.raises(UsageError, match=r"thrust_to_weight: 2.2; thrust_coefficient and speed_max give 4.078; leave"):
        own_multirotor(**QUAD, thrust_coefficient=3e-5, speed_max=632.5)


TABLE = {
    "throttle_percent": [50, 65, 75, 85, 100],
    "thrust_g": [510, 760, 960, 1130, 1390],
    "rpm": [3900, 4700, 5300, 5750, 6400],
    "power_W": [58, 104, 150, 195, 270],
}
HEXA: dict[str, Any] = {"mass": 3.5, "arm": 0.35, "rotors": 6, "attitude_bandwidth": 6.0}


def test_a_motor_by_its_data_sheet() -> None:
    """3.5 kg on six motors are 583.3 g each: 54.4 % by a line between rows, and 1390/583.3 = 2.383."""
    found = own_multirotor(**HEXA, motor_table=TABLE)
    told = derived(found)
    assert told["thrust_to_weight"] == pytest.approx(2.382, abs=0.002)
    # 1390 g at 6400/min are 3.04e-5; the other rows agree within a few percent.
    assert found.thrust_coefficient == pytest.approx(3.04e-5, rel=0.03)
    assert told["hover_throttle"] == pytest.approx(0.544, abs=0.03)
    still = Vec3(*np.zeros((3, 1)))
    hover = found.initial_state(Vec3(*np.zeros((3, 1))), Euler(*np.zeros((3, 1))), still, still)
    # Between 58 and 104 W of each of six, over thrust to the power 3/2, and 5 W of avionics.
    share = (583.33**1.5 - 510**1.5) / (760**1.5 - 510**1.5)
    assert float(found.load(hover).power[0]) == pytest.approx(6 * (58 + share * 46) + 5, rel=1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({name: values[:1] for name, values in TABLE.items()}, "has 1 row; at least 2 are needed"),
        ({name: [] for name in TABLE}, "has 0 rows; at least 2 are needed"),
        ({**TABLE, "thrust_g": [-510, 760, 700, 1130, 1390]}, "thrust_g of row 1 is -510; allowed: above 0"),
        ({**TABLE, "thrust_g": [510, 760, 700, 1130, 1390]}, "thrust does not rise from row 2 to row 3"),
        ({**TABLE, "rpm": [3900, 4700]}, "columns of different lengths"),
        ({**TABLE, "rpm": ["a", 1, 2, 3, 4]}, "rpm: row 1 is 'a', which is not a number"),
        ({**TABLE, "watts": [1, 2]}, "no column is called 'watts'"),
        ({k: v for k, v in TABLE.items() if k != "power_W"}, "has no column power_W"),
        ({**TABLE, "throttle_percent": [50, 65, 75, 85, 110]}, "throttle of row 5 is 110 %"),
        ({**TABLE, "thrust_N": [1, 2, 3, 4, 5]}, "gives thrust twice"),
    ],
)
def test_a_table_that_cannot_be_meant(change: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=rf"motor_table: .*{words}"):
        own_multirotor(**HEXA, motor_table=change)


def test_a_table_that_lifts_too_little() -> None:
    with pytest.raises(UsageError, match=r"motor_table: 6 motors lift 81.79 N at most, and the vehicle weighs 98.1 N"):
        own_multirotor(**{**HEXA, "mass": 10.0}, motor_table=TABLE)


@pytest.mark.parametrize(
    ("name", "ratio", "throttle"),
    # Largest thrust over weight, and hover: N k_T w_max^2/(m g) of the sources, its root (a throttle that is a speed).
    [
        ("x500", 1.6886, 0.7696),
        ("hummingbird", 10.220, 0.3128),
        ("pelican", 2.8596, 0.5914),
        ("crazyflie", 1.5338, 0.8074),
        ("hexa4", 2.2477, 0.6670),
    ],
)
def test_published_sets_carry_their_weight_as_published(name: str, ratio: float, throttle: float) -> None:
    told = derived(SETS[name]())
    assert told["thrust_to_weight"] == pytest.approx(ratio, rel=1e-4)
    assert told["hover_throttle"] == pytest.approx(throttle, rel=2e-4)


def test_a_motor_table_may_be_a_csv_file(tmp_path: Path) -> None:
    """The table of the data sheet by the names and units that sheets have; more columns are not looked at."""
    path = tmp_path / "motor.csv"
    rows = zip(*TABLE.values(), strict=True)
    lines = ["throttle [%];thrust [g];rpm;power [W];current [A]", *(";".join(map(str, (*row, "4,2"))) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert list(TABLE) == ["throttle_percent", "thrust_g", "rpm", "power_W"]
    assert own_multirotor(**HEXA, motor_table={"file": str(path)}) == own_multirotor(**HEXA, motor_table=TABLE)


def test_the_power_of_a_motor_may_be_voltage_and_current(tmp_path: Path) -> None:
    path = tmp_path / "motor.csv"
    rows = zip(*TABLE.values(), strict=True)
    lines = [f"{throttle},{thrust},{rpm},16,{power / 16}" for throttle, thrust, rpm, power in rows]
    lines.insert(0, "Throttle [%],Thrust [g],RPM,Voltage [V],Current [A]")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert own_multirotor(**HEXA, motor_table={"file": str(path)}) == own_multirotor(**HEXA, motor_table=TABLE)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "throttle,thrust_N,rpm,power_W\n0.5,5,4000,60\n1,x,6000,200\n",
            "line 3: column 'thrust_N': 'x' is not a finite number",
        ),
        ("throttle,thrust_N,rpm,power_W\n0.5,5,4000\n", "line 2: 3 fields, the header has 4"),
        (
            "throttle,thrust [kg],rpm,power_W\n0.5,5,4000,60\n1,9,6000,200\n",
            "line 1: has no column thrust_N or thrust_g; found throttle, thrust [kg], rpm, power_W",
        ),
        (
            "throttle,thrust_g,rpm,power_W\n0.5,0.5,4000,60\n1,0.9,6000,200\n",
            "N (thrust_g is in grams, mass in kg)",
        ),
        ("rpm,rpm\n1,2\n", "line 1: the column 'rpm' is there 2 times"),
        ("a,b\n1,2\n", "line 1: no column is called throttle"),
        (
            "throttle,thrust_N,rpm,current_A\n0.5,5,4000,3\n1,9,6000,9\n",
            "motor.csv: has no column power_W, nor voltage_V and current_A, from which it follows",
        ),
        ("", "not CSV: the file is empty"),
    ],
)
def test_a_bad_motor_file_is_named(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "motor.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=f"motor_table: .*{re.escape(words)}"):
        own_multirotor(**HEXA, motor_table={"file": str(path)})


def test_a_motor_file_that_is_not_there_and_one_without_file() -> None:
    with pytest.raises(UsageError, match=r"motor_table: nowhere\.csv: cannot be read: No such file"):
        own_multirotor(**HEXA, motor_table={"file": "nowhere.csv"})
    with pytest.raises(UsageError, match=r"found 'motor\.csv'; a CSV file is \{file: motor\.csv\}"):
        own_multirotor(**HEXA, motor_table="motor.csv")  # type: ignore[arg-type]
    grams = {"thrust_N" if name == "thrust_g" else name: values for name, values in TABLE.items()}
    with pytest.raises(UsageError, match=r"times the weight; allowed: at most 20 \(thrust_N is in newtons"):
        own_multirotor(**HEXA, motor_table=grams)


def test_the_rigid_pelican_at_the_weight_of_the_identified_one_hovers_at_77_percent() -> None:
    heavy = Multirotor(**{**vars(SETS["pelican"]()), "mass": 1.68})
    told = derived(heavy)
    assert told["hover_speed_rad_s"] / told["speed_max_rad_s"] == pytest.approx(0.7665, abs=5e-4)


@pytest.mark.parametrize(
    ("geometry", "count", "first"),
    [
        ("quad_x", 4, (0.2121, 0.2121)),
        ("quad_plus", 4, (0.3, 0.0)),
        ("hexa_x", 6, (0.2598, 0.15)),
        ("hexa_plus", 6, (0.3, 0.0)),
        ("octo_x", 8, (0.2772, 0.1148)),
        ("coaxial_x8", 8, (0.2121, 0.2121)),
    ],
)
def test_usual_arrangements(geometry: str, count: int, first: tuple[float, float]) -> None:
    rotors = rotors_of(geometry, 0.3, 0.05)
    assert len(rotors) == count
    np.testing.assert_allclose(rotors[0].position, (*first, -0.05), atol=5e-5)
    # The front right one turns counterclockwise, torques cancel, and every hub is an arm away.
    assert rotors[0].direction == -1
    assert sum(rotor.direction for rotor in rotors) == 0
    np.testing.assert_allclose([math.hypot(*rotor.position[:2]) for rotor in rotors], 0.3)
    if geometry == "coaxial_x8":
        assert [rotor.direction for rotor in rotors[:4]] == [-rotor.direction for rotor in rotors[4:]]
        assert rotors[4].position[:2] == rotors[0].position[:2]
        assert rotors[4].position[2] == pytest.approx(-0.05 + 0.06)


def test_a_pair_on_one_axis_gives_nine_tenths_of_two() -> None:
    eight = {**QUAD, "mass": 4.0, "rotors": 8, "thrust_to_weight": 2.0, "attitude_bandwidth": 6.0, "arm": 0.3}
    alone, pairs = own_multirotor(**eight, spin_up=0.02), own_multirotor(**eight, geometry="coaxial_x8", spin_up=0.02)
    disc = (pairs.rotor_radius / alone.rotor_radius) ** 4
    assert pairs.thrust_coefficient / alone.thrust_coefficient / disc == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": 0.0}, r"mass: 0 kg; allowed: 0\.01 to 100 kg"),
        ({"thrust_to_weight": 0.9}, r"thrust_to_weight: 0\.9; allowed: 1\.2 to 20"),
        ({"hover_throttle": 0.7}, r"hover_throttle: 0\.7; with thrust_to_weight 2\.2 .* at 0\.455 .* to 0\.674 "),
        ({"hover_throttle": 0.4}, r"hover_throttle: 0\.4; with thrust_to_weight 2\.2"),
        ({"attitude_bandwidth": 20.0}, r"attitude_bandwidth: 20 rad/s; rotors of .* 0\.0162 s allow 9\.26"),
        ({"rotors": 5}, r"rotors: 5; allowed: 4, 6, 8"),
        ({"rotors": 6, "geometry": "quad_x"}, r"rotors: 6; 'quad_x' has 4"),
        ({"geometry": "quadx"}, r"geometry: no arrangement is called 'quadx'; did you mean 'quad_x'\?"),
        ({"arm": True}, r"arm: .*; allowed: 0\.02 to 3 m"),
    ],
)
def test_numbers_that_cannot_be_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        own_multirotor(**{**QUAD, **changes})


@pytest.mark.parametrize(("name", "height"), [("x500", 0.0), ("x500", 3000.0), ("hummingbird", 0.0), ("hexa4", 0.0)])
@pytest.mark.long
def test_it_stays_where_it_is_at_the_airspeed_of_its_lean(name: str, height: float) -> None:
    """The forces of the model itself, at the lean and the thrust of balance, are its weight."""
    vehicle, lean = SETS[name]().in_air(SiteAir.of(height)), 0.4
    wind, thrust = vehicle.leaning(np.array([lean]))  # type: ignore[misc]
    with jax.enable_x64(True):
        model = cast(vehicle, np.float64)
        zero = jnp.zeros(1)
        still, level = Vec3(zero, zero, zero), Euler(zero, zero - lean, zero)
        state = model.initial_state(still, level, still, still)
        state = model.with_thrust(state, jnp.asarray(thrust))
        # A wind from the north, into which it leans.
        air = Vec3(zero - wind, zero, zero)

        def air_velocity(trig: AttitudeTrig) -> Vec3:
            return trig.rotation().to_body(air)

        ground = zero + 5000.0, Vec3(zero, zero, zero - 1.0)
        around = Around(lambda place: ground, still)
        force = model.specific_force(
            state, model.idle_command(zero), air_velocity, ProcessNoise(still, still), 0.02, around
        )
        found = AttitudeTrig.of(level).rotation().to_ned(force)
    np.testing.assert_allclose(found.stack()[0], [0.0, 0.0, -9.81], atol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("six", OTHERS, ids=lambda six: f"{six['mass']} kg")
def test_it_leans_as_fast_as_was_asked_for(six: dict[str, Any]) -> None:
    """63 % of a step of roll after 1/bandwidth, within 5 %, and hardly any overshoot."""
    vehicle, dt, roll = cast(own_multirotor(**six), np.float32), 0.004, 0.3
    zero = jnp.zeros(1)
    still = Vec3(zero, zero, zero)
    start = vehicle.initial_state(Vec3(zero, zero, zero - 50.0), Euler(zero, zero, zero), still, still)
    throttle = vehicle.throttle_of(vehicle.mass * vehicle.gravity / math.cos(roll))
    command = AttitudeCommand(zero, zero + roll, zero + throttle, zero)

    @partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0})
    def fly(state: Any) -> Any:
        def step(state: Any, _: Any) -> Any:
            after, _ = vehicle.step(state, command, lambda trig: still, ProcessNoise(still, still), dt)
            return after, after.quaternion.euler().roll[0]

        return jax.lax.scan(step, state, None, length=300)[1]

    flown = np.concatenate([[0.0], np.asarray(fly(start))])
    time = np.interp(0.632 * roll, flown[: np.argmax(flown) + 1], dt * np.arange(np.argmax(flown) + 1))
    assert time == pytest.approx(1.0 / six["attitude_bandwidth"], rel=0.05)
    assert flown.max() < 1.05 * roll


@pytest.mark.parametrize(
    ("column", "values", "words"),
    [
        # A radius of 0.45 x 0.35 m = 0.1575 m; 64/min are 6.70 rad/s.
        (
            "rpm",
            [39, 47, 53, 57.5, 64],
            "rpm of row 5 is 64: the tips of a propeller of radius 0.157 m move at 1.06 m/s",
        ),
        # Momentum theory: 5.00 N^1.5 / (2 x 1.225 kg/m^3 x 0.0779 m^2)^0.5 = 25.6 W; 23.3 to 256 W.
        (
            "power_W",
            [0.58, 1.04, 1.5, 1.95, 2.7],
            "power_W of row 1 is 0.58 W for 5 N of thrust; with a propeller of ra",
        ),
        # (5300/53)^2 of the same thrust.
        ("rpm", [3900, 4700, 4750, 4760, 9000], "thrust over rpm squared of row 5 is 0.4"),
    ],
)
def test_a_table_of_no_motor_is_warned_of(column: str, values: list[float], words: str) -> None:
    with pytest.warns(UserWarning, match=f"motor_table: {words}"):
        own_multirotor(**HEXA, motor_table={**TABLE, column: values})
