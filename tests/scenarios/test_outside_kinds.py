"""Bad components from outside of every kind: what is said names file, class, method and what was expected."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.scenarios.test_outside import SENSOR, _as_before, complaint, written  # noqa: F401

from qrsim import cli
from qrsim.scenarios.scenario import load_scenario

POINT_MASS = (Path(__file__).parents[2] / "examples/outside/point_mass.py").read_text()
CLIMB = (Path(__file__).parents[2] / "examples/outside/climb.py").read_text()
CONTRACTS = """
import jax.numpy as jnp
import qrsim
from qrsim.control.contracts import Controller
from qrsim.models.atmosphere.contracts import Turbulence, Wind
from qrsim.models.scene.contracts import Area
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.vehicles.contracts import Battery, Vehicle
from qrsim.tasks.contracts import Task


@qrsim.record
"""
LEVEL = """
import jax.numpy as jnp
import qrsim
from qrsim.control.contracts import Controller


@qrsim.record
class Own(Controller):
    throttle: float = qrsim.parameter(0.59, unit="1", doc="throttle")
    setpoints = (qrsim.WaypointSetpoint,)
    gives = qrsim.Command
    feed = "truth"

    def init(self, estimate):
        return None

    def step(self, state, estimate, setpoint, dt):
        zero = jnp.zeros_like(setpoint.yaw)
        return None, qrsim.Command(zero, zero, zero + self.throttle, zero, zero + 12.0)
"""
SETTINGS = 'period: float = qrsim.setting(0.1, unit="s", doc="interval", above=0.0)'
FLEET = 'fleet: str = qrsim.setting("pelicans", doc="fleet")'


def bare(kind: str, body: str = "pass") -> str:
    return f"{CONTRACTS}class Own({kind}):\n    {body}\n"


def changed(text: str, before: str, after: str) -> str:
    assert before in text
    return text.replace(before, after)


def mass(before: str, after: str) -> str:
    return changed(POINT_MASS, before, after).replace("PointMass", "Own")


def gauge(before: str, after: str) -> str:
    return changed(SENSOR, before, after).replace("Gauge", "Own")


def battery(attribute: str, start: str, after: str, voltage: str) -> str:
    methods = {"init(self, like)": start, "step(self, state, load, dt)": after, "voltage(self, state, load)": voltage}
    lines = [attribute, *(f"def {name}: return {value}" for name, value in methods.items())]
    return bare("Battery", "\n    ".join(lines))


def climb(names: str) -> str:
    return changed(CLIMB, 'Axis("to_climb", "m"), Axis("climb_rate", "m/s")', names).replace("Climb", "Own")


def area(checks: str, margin: str) -> str:
    return bare(
        "Area",
        f"def check(self, position_ned):\n        return {checks}\n    def margin(self, position_ned):"
        f"\n        return {margin}",
    )


# Of each kind: where it stands in a scenario, what is in its file, and what is said after the file's name.
BAD: dict[str, tuple[str, str, str]] = {
    "wind inherits": ("wind", bare("Wind"), "class Own lacks the method velocity_ned(height_agl, seconds, fraction)"),
    "turbulence inherits": ("turbulence", bare("Turbulence"), "class Own lacks the method init(draw) that a turb"),
    "sensor inherits": ("sensor", bare("Sensor", SETTINGS), "class Own lacks the method init(draw) that a sensor"),
    "vehicle inherits": (
        "vehicle",
        mass("def step", "def stepx"),
        "class Own lacks the method step(state, command, air_velocity, noise, dt) that a vehicle has; did you mean "
        "that by 'stepx'?",
    ),
    "controller inherits": (
        "controller",
        changed(LEVEL, "def step", "def steps"),
        "class Own lacks the method step(state, estimate, setpoint, dt) that a controller has; did you mean that by "
        "'steps'?",
    ),
    "task inherits": (
        "task",
        changed(changed(CLIMB, "class Climb:", "class Own(Task):"), "def sees", "def seen").replace(
            "import qrsim\n", "import qrsim\nfrom qrsim.tasks.contracts import Task\n", 1
        ),
        "class Own lacks the method sees(world) that a task has; did you mean that by 'seen'?",
    ),
    "area inherits": ("area", bare("Area"), "class Own lacks the method check(position_ned) that an area has"),
    "battery inherits": ("battery", bare("Battery"), "class Own lacks the method init(like) that a battery has"),
    "inherits from a class of its own": (
        "sensor",
        gauge("@qrsim.record\nclass Gauge:", "import abc\n\nclass Base(abc.ABC):\n    @abc.abstractmethod\n    def "
              "spare(self): ...\n\n@qrsim.record\nclass Gauge(Base):"),
        "class Own lacks 'spare', which is abstract in a class that it inherits from",
    ),
    "command_type is a text": (
        "vehicle",
        mass("command_type = qrsim.Command", 'command_type = "Command"'),
        "Own.command_type is 'Command'; expected a class",
    ),
    "command_type is no record": (
        "vehicle",
        mass("command_type = qrsim.Command", "command_type = dict"),
        "Own.command_type is <class 'dict'>; expected a record (@qrsim.record) of arrays (n,), as qrsim.Command",
    ),
    "actions without the command": (
        "vehicle",
        mass("actions = (qrsim.Command,)", "actions = (qrsim.VelocitySetpoint,)"),
        "expected Command, its command_type, among them",
    ),
    "setpoints are no tuple": (
        "controller",
        changed(LEVEL, "(qrsim.WaypointSetpoint,)", "qrsim.WaypointSetpoint"),
        "expected a tuple of classes, as (qrsim.WaypointSetpoint,)",
    ),
    "normals are a text": (
        "turbulence",
        bare("Turbulence", 'normals = "a"'),
        "Own.normals is 'a'; expected a whole number, 0 or more",
    ),
    "None for an array of a reading": (
        "sensor",
        gauge("HeightReading(-position_ned.z * self.gain)", "HeightReading(None)"),
        "Own.init: the reading.height_agl is None; expected an array of shape (1,)",
    ),
    "no load": (
        "vehicle",
        mass("return Load(thrust=self.mass * 9.81, weight=self.mass * 9.81)", "return None"),
        "Own.load: it returned NoneType; expected a Load",
    ),
    "load of a text": (
        "vehicle",
        mass("Load(thrust=self.mass * 9.81", 'Load(thrust="a"'),
        "Own.load: the load.thrust is 'a'; expected an array of shape (1,)",
    ),
    "battery of nothing": (
        "battery",
        battery("", "None", "None", "None"),
        "Own.voltage: it returned None, and so did init; expected a voltage, an array of shape (1,), or a state",
    ),
    "battery that drains without a charge": (
        "battery",
        battery("drains = True", "like * 0.0", "state", "state + 12.0"),
        "expected a record with the field charge, since drains is True",
    ),
    "battery of one voltage": (
        "battery",
        battery("", "None", "None", "12.0"),
        "Own.voltage: the voltage has shape (); expected (1,)",
    ),
    "command of scalars": (
        "controller",
        changed(LEVEL, "(zero, zero, zero + self.throttle, zero, zero + 12.0)", "(0.0, 0.0, 0.59, 0.0, 12.0)"),
        "Own.step: the command.pitch has shape (); expected (1,), one number for each vehicle",
    ),
    "one name for two numbers": (
        "task",
        climb('(Axis("to_climb", "m"),)'),
        "Own.observe: the observation has 2 numbers, but Own.sees names 1; expected as many",
    ),
    "names that are texts": (
        "task",
        climb('"to_climb", "rate"'),
        "Own.sees: it returned a tuple of 2; expected a tuple of Axis (qrsim.tasks.agents), one for each number",
    ),
    "wrong part of a state": (
        "vehicle",
        mass("return Pose(position_ned, attitude, velocity", "return Pose(position_ned, position_ned, velocity"),
        "Own.initial_state: the state.attitude is Vec3; expected a qrsim.Euler of arrays of shape (1,)",
    ),
    "no pose": (
        "vehicle",
        mass("        return state\n", "        return None\n"),
        "Own.pose: it returned NoneType; expected a Pose",
    ),
    "idle command of scalars": (
        "vehicle",
        mass("(zero, zero, zero + self.hover_throttle, zero, zero + 12.0)", "(0.0, 0.0, 0.59, 0.0, 12.0)"),
        "Own.idle_command: the command.pitch has shape (); expected (1,), one number for each vehicle",
    ),
    "no checks": (
        "area",
        area("None", "position_ned.x"),
        "Own.check: it returned NoneType; expected a list of (code, value, broken)",
    ),
    "check of two": (
        "area",
        area("[(17, position_ned.x)]", "position_ned.x"),
        "Own.check: check 0 is a tuple of 2; expected (code, value, broken)",
    ),
    "check without a reason": (
        "area",
        area("[(170, position_ned.x, position_ned.x > 9.0)]", "position_ned.x"),
        "Own.check: the code of check 0 is 170; expected reason_code(...) of qrsim.models.scene.area",
    ),
    "check that is not true or false": (
        "area",
        area("[(17, position_ned.x, position_ned.x)]", "position_ned.x"),
        "Own.check: broken of check 0 is an array of shape (1,); expected an array of bool of shape (1,)",
    ),
    "margin of one": (
        "area",
        area("[(17, position_ned.x, position_ned.x > 9.0)]", "position_ned.x.sum()"),
        "Own.margin: the result has shape (); expected (1,), one number for each vehicle",
    ),
    "margin that raises": (
        "area",
        area("[(17, position_ned.x, position_ned.x > 9.0)]", "int('far')"),
        "Own.margin: ValueError: invalid literal for int() with base 10: 'far' (FILE, line 17)",
    ),
    "placement without a place": (
        "placement",
        CONTRACTS + "class Own:\n    pass\n",
        "class Own lacks the method place(draw, start, area) that a placement has",
    ),
    "placement without a start": (
        "placement",
        CONTRACTS + "class Own:\n    def place(self, draw, start, area):\n        return start.position_ned, True\n",
        "Own.place: the start is Vec3; expected the Start that it was handed, by qrsim.core.tree.replace",
    ),
    "noise without normals": (
        "vehicle",
        mass("        before =", "        noise.normals(1)\n        before ="),
        "Own.step: its noise is None, which draw_noise returns where a vehicle has none of its own; expected def "
        "draw_noise(self, draw, dt) that returns draw.normals(count), and normals = count (FILE, line 32)",
    ),
    "sensor with fewer normals than it declares": (
        "sensor",
        changed(gauge("-position_ned.z * self.gain", "draw.normals(1)[0]"), "reads =", "normals = 2\n    reads ="),
        "Own.step: it draws 1 normal, and the class declares normals = 2; expected normals = 1",
    ),
    "sensor with fewer first normals than it declares": (
        "sensor",
        gauge("-position_ned.z * self.gain", "draw.normals(1)[0]").replace(
            "    reads =", "    normals, first_normals = 1, 3\n    reads ="
        ),
        "Own.init: it draws 1 normal, and the class declares first_normals = 3; expected first_normals = 1",
    ),
    "turbulence with fewer normals than it declares": (
        "turbulence",
        bare("Turbulence", "\n    ".join([
            "normals = 3",
            "def init(self, draw): return draw.normals(2)[1]",
            "def step(self, state, draw, height_agl, velocity_ned, mean_wind_ned, dt): return draw.normals(2)[1]",
            "def gust_ned(self, state, height_agl): return qrsim.Vec3(state, state, state)",
        ])),
        "Own.step: it draws 2 normals, and the class declares normals = 3; expected normals = 2",
    ),
    "vehicle with normals that nobody draws": (
        "vehicle",
        mass("    actions =", "    normals = 6\n    actions ="),
        "Own.draw_noise: it draws no normals, and the class declares normals = 6; expected normals = 0",
    ),
}  # fmt: skip


def with_own(kind: str, named: str) -> dict[str, Any]:
    """A scenario with one component of its own of a kind."""
    content: dict[str, Any] = {"extends": "hover_ideal", "name": "mine"}
    if kind == "task":
        return {"extends": "keep_velocity", "name": "mine", "task": {"type": named}}
    if kind in ("wind", "turbulence", "area"):
        return {**content, "world": {kind: {"type": named}}}
    part: Any = {"own": {"type": named}} if kind == "sensor" else {"type": named}
    fleet: dict[str, Any] = {"sensors" if kind == "sensor" else kind: part}
    if kind == "vehicle":
        fleet["controller"] = {"type": "waypoint", "feed": "truth"}
    return {**content, "fleets": {"pelicans": fleet}}


# Of each check one is looked at in the short tier.
LONG = {"load of a text", "battery that drains without a charge", "battery of one voltage", "names that are texts",
        "wrong part of a state", "check of two", "check without a reason", "check that is not true or false",
        "margin of one", "placement without a start", "vehicle inherits", "controller inherits", "task inherits",
        "sensor with fewer first normals than it declares", "vehicle with normals that nobody draws",
        "area inherits", "battery inherits", "actions without the command", "idle command of scalars"}  # fmt: skip


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.long] * (name in LONG)) for name in BAD])
def test_one_line_says_where_and_what(name: str, tmp_path: Path):
    kind, text, message = BAD[name]
    file = written(tmp_path, text, "own.py")
    line = complaint(with_own(kind, f"{file}:Own"))
    assert f"{file}: " in line
    assert message.replace("FILE", str(file)) in line


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Exit code 2 and no traceback, where a class inherits its contract."""
    written(tmp_path, bare("Wind"), "own.py")
    (tmp_path / "mine.yaml").write_text("extends: hover_ideal\nworld: {wind: {type: './own.py:Own'}}\n")
    assert cli.main(["check", str(tmp_path / "mine.yaml")]) == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert "lacks the method velocity_ned" in said.replace("\n", "")


@pytest.mark.parametrize("where", ["init", "step"])
def test_normals_of_the_start_or_of_a_step_count(where: str, tmp_path: Path):
    """A bias that is drawn once, and noise that begins with the first step, are each as many as declared."""
    drawn = gauge("-position_ned.z * self.gain", "draw.normals(2)[1]").replace(
        "    reads =", "    normals = 2\n    reads ="
    )
    begin, middle, end = drawn.split("draw.normals(2)[1]")
    both = ["draw.normals(2)[1]", "position_ned.z"]
    first, second = both if where == "init" else reversed(both)
    text = begin + first + middle + second + end
    load_scenario(with_own("sensor", f"{written(tmp_path, text, 'own.py')}:Own"))
