"""Bad components from outside of every kind: what is said names file, class, method and what was expected."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.scenarios.test_outside import SENSOR, _as_before, complaint, written  # noqa: F401

from qrsim import cli

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
}  # fmt: skip


def with_own(kind: str, named: str) -> dict[str, Any]:
    """A scenario with one component of its own of a kind."""
    content: dict[str, Any] = {"extends": "hover", "name": "mine"}
    if kind == "task":
        return {**content, "task": {"type": named}}
    if kind in ("wind", "turbulence", "area"):
        return {**content, "world": {kind: {"type": named}}}
    part: Any = {"own": {"type": named}} if kind == "sensor" else {"type": named}
    fleet: dict[str, Any] = {"sensors" if kind == "sensor" else kind: part}
    if kind == "vehicle":
        fleet["controller"] = {"type": "waypoint", "feed": "truth"}
    return {**content, "fleets": {"pelicans": fleet}}


@pytest.mark.parametrize("name", BAD)
def test_one_line_says_where_and_what(name: str, tmp_path: Path):
    kind, text, message = BAD[name]
    file = written(tmp_path, text, "own.py")
    line = complaint(with_own(kind, f"{file}:Own"))
    assert f"{file}: " in line
    assert message in line


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Exit code 2 and no traceback, where a class inherits its contract."""
    written(tmp_path, bare("Wind"), "own.py")
    (tmp_path / "mine.yaml").write_text("extends: hover\nworld: {wind: {type: './own.py:Own'}}\n")
    assert cli.main(["check", str(tmp_path / "mine.yaml")]) == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert "lacks the method velocity_ned" in said.replace("\n", "")
