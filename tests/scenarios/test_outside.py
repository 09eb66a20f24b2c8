"""Components from outside: by file, by module, registered, from a package; and what is said of bad ones."""

from __future__ import annotations

import os
import pickle
import sys
import textwrap
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim import cli
from qrsim.errors import ScenarioError, UsageError
from qrsim.links.reference.tasks import uploaded
from qrsim.scenarios import catalogue, registry, schema
from qrsim.scenarios.scenario import load_scenario

SENSOR = '''
import jax.numpy as jnp
import numpy as np
import qrsim


@qrsim.record
class HeightReading:
    height_agl: float = qrsim.quantity(unit="m", doc="height above ground")


@qrsim.record
class Gauge:
    """A gauge."""

    gain: float = qrsim.parameter(1.0, unit="1", doc="what a height is multiplied by", minimum=0.5, maximum=4.0)
    period: float = qrsim.setting(0.1, unit="s", doc="interval", above=0.0)
    reads = ("position_ned",)

    def init(self, draw, position_ned) -> tuple[None, HeightReading]:
        return None, HeightReading(-position_ned.z * self.gain)

    def step(self, state, draw, position_ned) -> tuple[None, HeightReading]:
        return None, HeightReading(-position_ned.z * self.gain)
'''


@pytest.fixture(autouse=True)
def _as_before():
    """Forget what a test has taken in."""
    origins = dict(registry._ORIGINS)
    groups = {kind: dict(group) for kind, group in catalogue.KINDS.items()}
    yield
    registry._ORIGINS.clear()
    registry._ORIGINS.update(origins)
    for kind, group in groups.items():
        if catalogue.KINDS[kind] != group:
            catalogue.KINDS[kind].clear()
            catalogue.KINDS[kind].update(group)
            schema.refresh(kind)


def written(folder: Path, text: str = SENSOR, name: str = "gauge.py") -> Path:
    file = folder / name
    file.write_text(textwrap.dedent(text))
    return file


def with_gauge(named: str, **more: Any) -> dict[str, Any]:
    return {
        "extends": "hover_ideal",
        "name": "mine",
        "fleets": {"pelicans": {"sensors": {"gauge": {"type": named, **more}}}},
    }


def complaint(source: Any, *overrides: str) -> str:
    with pytest.raises(UsageError) as caught:
        load_scenario(source, overrides)
    (line,) = caught.value.problems if isinstance(caught.value, ScenarioError) else [str(caught.value)]
    assert "\n" not in line
    return line


class TestByFile:
    @pytest.mark.long
    def test_beside_the_scenario(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        """Wherever one stands, through extends, in both precisions, with the log's columns and the reading's name."""
        written(tmp_path)
        (tmp_path / "mine.yaml").write_text(
            "extends: hover_ideal\nfleets: {pelicans: {sensors: {gauge: {type: './gauge.py:Gauge', gain: 2.0}}}}\n"
        )
        (tmp_path / "below").mkdir()
        (tmp_path / "below" / "child.yaml").write_text(
            "extends: ../mine.yaml\nfleets: {pelicans: {sensors: {gauge: {gain: 3.0}}}}\n"
        )
        for name, gain in (("mine.yaml", 2.0), ("below/child.yaml", 3.0)):
            scenario = load_scenario(tmp_path / name)
            sensor = scenario.spec.fleets["pelicans"].sensors["gauge"]
            assert (sensor.type, sensor.gain) == (f"{tmp_path}/gauge.py:Gauge", gain)
        monkeypatch.chdir(tmp_path)
        for precision in ("float32", "float64"):
            simulation = qrsim.load("mine.yaml", precision=precision)
            reading = simulation.reset()
            # It stands at 10 m.
            assert reading.gauge.height_agl.dtype == precision
            np.testing.assert_allclose(reading.gauge.height_agl, 20.0, rtol=1e-6)
            np.testing.assert_allclose(simulation.step(ticks=5).gauge.height_agl, 20.0, atol=0.5)

    def test_a_pickled_simulation_loads_the_file_itself(self, tmp_path: Path):
        """In a process that has not seen the scenario; not where the file has changed."""
        file = written(tmp_path)
        simulation = qrsim.load(with_gauge(f"{file}:Gauge"), seed=3)
        simulation.reset()
        simulation.step(ticks=3)
        pickled = pickle.dumps(simulation)
        for name in [name for name in sys.modules if name.startswith("qrsim_file_gauge_")]:
            del sys.modules[name]
        again = pickle.loads(pickled)
        np.testing.assert_array_equal(again.step(ticks=9).gauge.height_agl, simulation.step(ticks=9).gauge.height_agl)
        for name in [name for name in sys.modules if name.startswith("qrsim_file_gauge_")]:
            del sys.modules[name]
        written(tmp_path, SENSOR + "\n")
        with pytest.raises(UsageError, match=r"gauge.py: it has changed since what names it was pickled"):
            pickle.loads(pickled)

    def test_in_python_and_by_an_override(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        """Relative to the working folder."""
        written(tmp_path)
        monkeypatch.chdir(tmp_path)
        of_dict = load_scenario(with_gauge("./gauge.py:Gauge"))
        of_override = load_scenario("hover_ideal", ["fleets.pelicans.sensors.gyroscope=gauge.py:Gauge"])
        assert of_dict.spec.fleets["pelicans"].sensors["gauge"].type == f"{tmp_path}/gauge.py:Gauge"
        assert of_override.spec.fleets["pelicans"].sensors["gyroscope"].type == f"{tmp_path}/gauge.py:Gauge"

    def test_a_file_that_has_changed_is_read_again(self, tmp_path: Path):
        file = written(tmp_path)
        assert load_scenario(with_gauge(f"{file}:Gauge")).spec.fleets["pelicans"].sensors["gauge"].gain == 1.0
        file.write_text(SENSOR.replace("parameter(1.0", "parameter(2.0"))
        assert load_scenario(with_gauge(f"{file}:Gauge")).spec.fleets["pelicans"].sensors["gauge"].gain == 2.0

    def test_parameters_are_checked_as_those_of_built_in_components(self, tmp_path: Path):
        named = f"{written(tmp_path)}:Gauge"
        where = "fleets.pelicans.sensors.gauge"
        assert complaint(with_gauge(named, gain=5.0)) == (
            f"{where}.gain: 5.0 is out of range; allowed: 0.5 to 4 (what a height is multiplied by)"
        )
        assert "no such parameter of" in complaint(with_gauge(named, gane=1.0))
        assert "did you mean 'gain'?" in complaint(with_gauge(named, gane=1.0))
        assert complaint(with_gauge(named, period=0.03)) == (
            f"{where}.period: 0.03 s is not a multiple of the time step 0.02 s"
        )
        assert complaint(with_gauge(named, gain=[1.0, 2.0])) == (
            f"{where}.gain: 2 numbers in a list; allowed: 1, one for each vehicle, or a number"
        )


class TestByModule:
    def test_of_the_working_folder(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        written(tmp_path, name="gauges_of_mine.py")
        monkeypatch.chdir(tmp_path)
        monkeypatch.syspath_prepend(str(tmp_path))
        scenario = load_scenario(with_gauge("gauges_of_mine:Gauge"))
        assert scenario.spec.fleets["pelicans"].sensors["gauge"].type == "gauges_of_mine:Gauge"
        assert "no module is called 'gauges_of_nine'; did you mean 'gauges_of_mine'?" in complaint(
            with_gauge("gauges_of_nine:Gauge")
        )
        del sys.modules["gauges_of_mine"]


class TestRegistered:
    def test_by_a_name(self, tmp_path: Path):
        gauge = registry.code.load_object("sensor", f"{written(tmp_path)}:Gauge")
        assert qrsim.register("sensor", "gauge", gauge) is gauge
        assert load_scenario(with_gauge("gauge")).spec.fleets["pelicans"].sensors["gauge"].gain == 1.0
        assert "did you mean 'gauge'?" in complaint(with_gauge("guage"))
        # The same again, as by a cell of a notebook that is run again.
        qrsim.register("sensor", "gauge", gauge)

    def test_twice(self, tmp_path: Path):
        one = registry.code.load_object("sensor", f"{written(tmp_path, name='one.py')}:Gauge")
        two = registry.code.load_object("sensor", f"{written(tmp_path, SENSOR + '# other', name='two.py')}:Gauge")
        qrsim.register("sensor", "gauge", one)
        with pytest.raises(UsageError) as caught:
            qrsim.register("sensor", "gauge", two)
        assert str(caught.value) == (
            f"register: sensor 'gauge' is registered twice: Gauge of {tmp_path}/one.py, line 12, and Gauge of "
            f"{tmp_path}/two.py, line 12"
        )
        with pytest.raises(UsageError, match="'barometer' is registered twice: it is the built-in"):
            qrsim.register("sensor", "barometer", one)

    def test_a_kind_that_does_not_exist(self):
        with pytest.raises(UsageError, match="no kind of component is called 'senser'; did you mean 'sensor'"):
            qrsim.register("senser", "gauge", object)

    @pytest.mark.long
    def test_objects(self, tmp_path: Path):
        """A component that a program has made stands where a built-in one can."""
        gauge = registry.code.load_object("sensor", f"{written(tmp_path)}:Gauge")
        scenario = qrsim.make_scenario([[0, 0, -10], [5, 0, -10]], sensors={"gauge": gauge(gain=[1.0, 2.0])},
                                       controller={"type": "waypoint", "feed": "truth"})  # fmt: skip
        simulation = qrsim.Simulation(scenario.world(), seed=0)
        np.testing.assert_allclose(simulation.reset().gauge.height_agl, [10.0, 20.0], rtol=1e-6)


class _Distribution:
    def __init__(self, name: str):
        self.metadata, self.version = {"Name": name}, "1.2"


def offering(monkeypatch: pytest.MonkeyPatch, **points: str) -> None:
    """Make some installed packages offer components."""
    made = []
    for package, text in points.items():
        name, _, value = text.partition("=")
        point = metadata.EntryPoint(name, value, registry.GROUP)
        vars(point)["dist"] = _Distribution(package)
        made.append(point)
    monkeypatch.setattr(registry.metadata, "entry_points", lambda group: made if group == "qrsim.components" else [])


class TestPackages:
    def test_loaded_when_named(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        written(tmp_path, name="gauges_in_a_package.py")
        monkeypatch.syspath_prepend(str(tmp_path))
        offering(monkeypatch, gauges="sensor.gauge=gauges_in_a_package:Gauge")
        row = {"kind": "sensor", "name": "gauge", "class": "gauges_in_a_package:Gauge"}
        assert row | {"from": "package: gauges 1.2 (gauges_in_a_package:Gauge)"} in registry.components()
        load_scenario("hover_ideal")
        assert "gauges_in_a_package" not in sys.modules
        load_scenario(with_gauge("gauge"))
        assert "gauges_in_a_package" in sys.modules
        del sys.modules["gauges_in_a_package"]

    @pytest.mark.parametrize(
        ("points", "message"),
        [
            ({"a": "sensor.g=m:A", "b": "sensor.g=n:B"}, r"sensor 'g' is registered twice: by a 1.2 \(m:A\) and by b"),
            ({"a": "gauge=m:A"}, "entry point 'gauge' of a 1.2 .*expected KIND.NAME, for example sensor.laser"),
            ({"a": "sensr.g=m:A"}, "no kind of component is called 'sensr'; did you mean 'sensor'"),
            ({"a": "sensor.barometer=m:A"}, "'barometer' is the name of a built-in sensor"),
        ],
    )
    def test_what_cannot_be(self, points: dict[str, str], message: str, monkeypatch: pytest.MonkeyPatch):
        offering(monkeypatch, **points)
        with pytest.raises(UsageError, match=message):
            registry.components()


def changed(before: str, after: str) -> str:
    assert before in SENSOR
    return SENSOR.replace(before, after)


BAD = {
    "no step": (
        changed("def step", "def stepp"),
        "class Gauge lacks the method step(state, draw, position_ned=...) that a sensor has; did you mean that by "
        "'stepp'?",
    ),
    "no step, and a field of a similar name": (
        changed("def step", "def stpe").replace("gain", "step_m"),
        "class Gauge lacks the method step(state, draw, position_ned=...) that a sensor has; did you mean that by "
        "'stpe'?",
    ),
    "arguments": (
        changed("def step(self, state, draw, position_ned)", "def step(self, draw, position)"),
        "Gauge.step takes (draw, position); expected (state, draw, position_ned=...), with which a sensor is called",
    ),
    "reads": (
        changed('reads = ("position_ned",)', 'reads = ("positionned",)'),
        "Gauge.reads names 'positionned', which a sensor cannot read; did you mean 'position_ned'?",
    ),
    "no period": (
        changed('    period: float = qrsim.setting(0.1, unit="s", doc="interval", above=0.0)\n', ""),
        "class Gauge lacks 'period' that a sensor has (see qrsim.models.sensors.contracts)",
    ),
    "no record": (
        changed("@qrsim.record\nclass Gauge:", "class Gauge:"),
        "class Gauge is no record; write @qrsim.record above it",
    ),
    "no metadata": (
        changed(
            'qrsim.parameter(1.0, unit="1", doc="what a height is multiplied by", minimum=0.5, maximum=4.0)', "1.0"
        ),
        "Gauge.gain has no unit; expected gain: ... = qrsim.parameter(default, unit=..., doc=...)",
    ),
    "no default that is a number": (
        changed("qrsim.parameter(1.0", "qrsim.parameter(float('nan')"),
        "Gauge.gain: its default is nan; expected a finite number",
    ),
    "more normals than it says": (
        changed("-position_ned.z * self.gain", "draw.normals(2)[1]"),
        "a component that declares 0 normals per step asked for 2",
    ),
    "no unit": (
        changed('unit="1", doc="what', 'unit="", doc="what'),
        "Gauge.gain has no unit; expected one such as unit='m', or '1' for a plain number",
    ),
    "unit forgotten": (
        changed('unit="1", doc="what', 'doc="what'),
        "Gauge.gain has no unit; expected one such as unit='m', or '1' for a plain number",
    ),
    "reads is a text": (
        changed('reads = ("position_ned",)', 'reads = "position_ned"'),
        "Gauge.reads is 'position_ned'; expected a tuple of names, as (\"position_ned\",)",
    ),
    "leaves": (
        changed("-position_ned.z * self.gain", "sys.exit(0)").replace("import qrsim", "import qrsim, sys"),
        "Gauge.init: SystemExit: 0 (FILE, line 21)",
    ),
    "reading without unit": (
        changed('qrsim.quantity(unit="m", doc', "qrsim.quantity(doc"),
        "Gauge.init: HeightReading.height_agl has no unit; expected height_agl: ... = qrsim.quantity(unit=..., "
        "doc=...)",
    ),
    "shape": (
        changed("HeightReading(-position_ned.z * self.gain)", "HeightReading(jnp.zeros(3))"),
        "Gauge.init: the reading.height_agl has shape (3,); expected (1,), one number for each vehicle",
    ),
    "no pair": (
        changed("return None, HeightReading", "return HeightReading"),
        "Gauge.init: it returned HeightReading; expected a pair, the new state and the reading",
    ),
    "other state": (
        "return position_ned.z, H".join(SENSOR.rsplit("return None, H", 1)),
        "Gauge.step: the state was nothing and is now an array of shape (1,); expected the same structure",
    ),
    "if": (
        changed(
            "        return None, H", "        if position_ned.z[0] > 0.0:\n            pass\n        return None, H"
        ),
        "Gauge.init: it cannot be compiled, because Python's if, while, and, or, not ask for the value of an array; "
        "use jnp.where, &, |, ~ (FILE, line 21)",
    ),
    "numpy": (
        changed("-position_ned.z * self.gain", "np.abs(np.asarray(position_ned.z))"),
        "Gauge.init: it cannot be compiled, because a function of NumPy asks for the values of an array; use jax.numpy "
        "(FILE, line 21)",
    ),
    "raises": (
        changed("-position_ned.z * self.gain", "position_ned.zed"),
        "Gauge.init: AttributeError: 'Vec3' object has no attribute 'zed' (FILE, line 21)",
    ),
    "a function": ("def Gauge():\n    pass\n", "expected a class, found <function Gauge"),
    "import": (
        "import qrsim\n\nx = 1 / 0\n",
        "importing it failed: ZeroDivisionError: division by zero (FILE, line 3)",
    ),
    "syntax": ("def x(:\n", "importing it failed: SyntaxError: invalid syntax (FILE, line 1)"),
}


class TestBadInput:
    @pytest.mark.parametrize("name", BAD)
    def test_one_line_says_where_and_what(self, name: str, tmp_path: Path):
        text, message = BAD[name]
        file = written(tmp_path, text)
        line = complaint(with_gauge(f"{file}:Gauge"))
        assert line.startswith("fleets.pelicans.sensors.gauge")
        assert str(file) in line
        assert message.replace("FILE", str(file)) in line

    def test_names(self, tmp_path: Path):
        file = written(tmp_path)
        assert complaint(with_gauge(f"{file}:Gauges")).endswith(f"{file} has no 'Gauges'; did you mean 'Gauge'?")
        assert complaint(with_gauge(f"{tmp_path}/gouge.py:Gauge")).endswith(
            f"there is no file {tmp_path}/gouge.py; did you mean '{file}'?"
        )

    @pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo])
    def test_what_is_no_file(self, make: Any, tmp_path: Path):
        make(tmp_path / "gauge.py")
        line = complaint(with_gauge(f"{tmp_path}/gauge.py:Gauge"))
        assert f"{tmp_path}/gauge.py: cannot be read: " in line
        assert "did you mean" not in line

    def test_a_file_without_its_ending(self):
        assert "'./gauge' is no module; expected my_package.my_module, or a file that ends in .py" in complaint(
            with_gauge("./gauge:Gauge")
        )

    def test_a_class_without_a_schema_spoils_no_other(self, tmp_path: Path):
        settings = '    table: np.ndarray = qrsim.setting(None, doc="a table")\n    reads ='
        file = written(tmp_path, changed("    reads =", settings))
        line = complaint(with_gauge(f"{file}:Gauge"))
        assert f"{file}: class Gauge has no schema: " in line
        assert "typing.Literal" in line
        good = written(tmp_path, name="good.py")
        assert load_scenario(with_gauge(f"{good}:Gauge"))

    @pytest.mark.long
    def test_a_controller_that_cannot_be_told_what_feeds_it(self, tmp_path: Path):
        file = written(
            tmp_path,
            """
import jax.numpy as jnp
import qrsim


@qrsim.record
class Level:
    throttle: float = qrsim.parameter(0.59, unit="1", doc="throttle")
    setpoints = (qrsim.WaypointSetpoint,)
    gives = qrsim.Command

    def init(self, estimate):
        return None

    def step(self, state, estimate, setpoint, dt):
        zero = jnp.zeros_like(setpoint.yaw)
        return None, qrsim.Command(zero, zero, zero + self.throttle, zero, zero + 12.0)
""",
        )
        fleets = {"pelicans": {"controller": {"type": f"{file}:Level"}}}
        assert load_scenario({"extends": "hover_ideal", "name": "own", "fleets": fleets})
        bare = {"pelicans": {"controller": {"type": f"{file}:Level"}, "sensors": None}}
        with pytest.raises(
            ScenarioError, match="fed with measurements, but the fleet has no sensors; set sensors to noisy"
        ):
            load_scenario({"extends": "hover_ideal", "name": "own", "fleets": bare})

    def test_on_the_command_line(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
        """Exit code 2 and no traceback, from every command that reads a scenario."""
        file = written(tmp_path, BAD["no step"][0])
        (tmp_path / "mine.yaml").write_text(
            "extends: hover_ideal\nfleets: {pelicans: {sensors: {gauge: {type: './gauge.py:Gauge'}}}}\n"
        )
        for words in (["run", "--out", str(tmp_path / "run")], ["check"], ["show"]):
            assert cli.main([words[0], str(tmp_path / "mine.yaml"), *words[1:]]) == 2
            said = capsys.readouterr().err
            assert "Traceback" not in said
            assert f"{file}: class Gauge lacks the method step" in said.replace("\n", "")


class TestOverTheNetwork:
    TEXT = "name: mine\nfleets: {a: {sensors: {gauge: {type: 'GAUGE'}}, vehicles: [{position_ned: [0, 0, -10]}]}}\n"

    @pytest.mark.parametrize("named", ["FILE:Gauge", "./gauge.py:Gauge", "os:path", "a.b:C", ":", "x:"])
    def test_code_is_refused_and_not_run(self, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        file = written(tmp_path, "open('ran', 'w').close()\n" + SENSOR)
        monkeypatch.chdir(tmp_path)
        with pytest.raises(
            ScenarioError, match="a scenario that a client sends can name no code; known: gnss_receiver"
        ):
            uploaded(self.TEXT.replace("GAUGE", named.replace("FILE", str(file))))
        assert not (tmp_path / "ran").exists()

    def test_nor_is_a_package(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        written(tmp_path, "open('ran', 'w').close()\n" + SENSOR, name="gauges_over_the_network.py")
        monkeypatch.chdir(tmp_path)
        monkeypatch.syspath_prepend(str(tmp_path))
        offering(monkeypatch, gauges="sensor.gauge=gauges_over_the_network:Gauge")
        with pytest.raises(ScenarioError, match="no such type 'gauge'"):
            uploaded(self.TEXT.replace("GAUGE", "gauge"))
        assert not (tmp_path / "ran").exists()

    def test_nor_is_what_the_operator_has(self, tmp_path: Path):
        qrsim.register("sensor", "gauge", registry.code.load_object("sensor", f"{written(tmp_path)}:Gauge"))
        with pytest.raises(ScenarioError) as caught:
            uploaded(self.TEXT.replace("GAUGE", "gauge"))
        assert "no such type 'gauge'" in str(caught.value)
        assert str(tmp_path) not in str(caught.value)

    def test_in_every_place_of_a_scenario(self):
        content = {
            "name": "mine",
            "world": {kind: {"type": "a:B"} for kind in ("wind", "turbulence", "gust", "area", "ground", "plume",
                                                         "terrain", "persons")}
            | {"sky": {"orbits": {"type": "a:B"}, "errors": {"type": "a:B"}}},
            "fleets": {"a": {part: {"type": "a:B"} for part in ("vehicle", "controller", "guidance", "battery",
                                                                "placement")} | {"sensors": {"b": {"type": "a:B"}}}},
            "task": {"type": "a:B"},
        }  # fmt: skip
        from qrsim.files.yaml_text import dump_yaml

        with pytest.raises(ScenarioError) as caught:
            uploaded(dump_yaml(content))
        assert sum("can name no code" in problem for problem in caught.value.problems) == 17


class TestSensorsOfOnesOwn:
    def test_faults_and_feeds_know_what_step_says(self, tmp_path: Path):
        named = f"{written(tmp_path)}:Gauge"
        content = with_gauge(named)
        content["fleets"]["pelicans"]["faults"] = [
            {"sensor": "gauge", "kind": "biased", "start": 1.0, "field": "height", "bias": 1.0}
        ]
        assert complaint(content) == (
            "fleets.pelicans.faults.0.field: the sensor does not report 'height'; did you mean 'height_agl'?"
        )
        content["fleets"]["pelicans"]["faults"][0]["field"] = "height_agl"
        load_scenario(content)
        written(tmp_path, SENSOR.replace(" -> tuple[None, HeightReading]", ""))
        assert complaint(content) == (
            "fleets.pelicans.faults.0.sensor: Gauge.step does not declare its return type; expected '-> tuple[State, "
            "Reading]'"
        )
        # A period need not be one of the sky where its path has "gnss" in it and it does not look at the sky.
        other = written(tmp_path, name="gnss_gauge.py")
        load_scenario(with_gauge(f"{other}:Gauge", period=0.06))


class TestEstimatorsAndMetrics:
    TEXT = """
    import jax.numpy as jnp

    class Speed:
        def init(self, world, state):
            return jnp.zeros(())

        def update(self, memory, world, state, tick):
            return jnp.maximum(memory, state.fleets[0].vehicle.velocity_body.norm().max())

        def finish(self, memory, world, state):
            return {"speed_max_m_s": memory}

    class Half:
        def init(self, reading):
            return 0
    """

    def test_metrics_by_a_file(self, tmp_path: Path):
        file = written(tmp_path, self.TEXT)
        # In still air a cascade would not move at all.
        found = qrsim.rollout("keep_spot", ticks=20, worlds=2, metrics=f"{file}:Speed")
        assert found.metrics["speed_max_m_s"].shape == (2,)
        assert (found.metrics["speed_max_m_s"] > 0.0).all()

    def test_what_is_none(self, tmp_path: Path):
        file = written(tmp_path, self.TEXT)
        with pytest.raises(
            UsageError, match=r"class Half lacks the method step\(reading, memory\) that an estimator has"
        ):
            qrsim.rollout("hover_ideal", ticks=20, estimator=f"{file}:Half")
        with pytest.raises(UsageError, match="expected module:function or file"):
            qrsim.rollout("hover_ideal", ticks=20, metrics="speed")

    @pytest.mark.parametrize(
        ("update", "words"),
        [
            (
                lambda self, memory, world, state: memory,
                r"update takes \(memory, world, state\); expected \(memory, world",
            ),
            (
                lambda self, memory, world, state, tick: {"a": memory},
                r"update returns a memory of shapes \{'a': \(\)\}",
            ),
            (lambda self, memory, world, state, tick: np.zeros(3), r"shapes \(3,\); expected those of init, \(\)"),
        ],
    )
    def test_metrics_that_cannot_be_kept_from_tick_to_tick(self, update: Any, words: str):
        own = {"init": lambda self, world, state: np.float32(0), "update": update, "finish": lambda *_: {}}
        kind = type("Own", (), own)
        for metrics in (kind, kind()):
            with pytest.raises(UsageError, match=words):
                qrsim.rollout("hover_ideal", ticks=2, metrics=metrics)


# Of every kind the class of a built-in component, under another name, in a file of a user.
COPIES = """
import qrsim
from qrsim.scenarios import catalogue

@qrsim.record
class Wind(catalogue.WINDS["log_shear"]): pass
@qrsim.record
class Turbulence(catalogue.TURBULENCES["dryden"]): pass
@qrsim.record
class Gust(catalogue.GUSTS["discrete"]): pass
@qrsim.record
class Errors(catalogue.SKY_ERRORS["ou"]): pass
@qrsim.record
class Orbits(catalogue.ORBITS["nominal_constellation"]): pass
@qrsim.record
class Area(catalogue.AREAS["box"]): pass
@qrsim.record
class Vehicle(catalogue.VEHICLES["pelican"]):
    adds_position = True
@qrsim.record
class Battery(catalogue.BATTERIES["lithium_polymer"]): pass
@qrsim.record
class Controller(catalogue.CONTROLLERS["waypoint"]): pass
@qrsim.record
class Guidance(catalogue.GUIDANCE["route"]): pass
@qrsim.record
class Receiver(catalogue.SENSORS["gnss_receiver"]): pass
@qrsim.record
class Task(catalogue.TASKS["keep_spot"]): pass
"""


def of_every_kind(file: str) -> dict[str, Any]:
    """A scenario of built-in components, or of the same from a file."""

    def named(built_in: str, own: str) -> str:
        return f"{file}:{own}" if file else built_in

    gust = {"start_time": 0.2, "length": 10.0, "speed": 3.0, "wind_from_deg": 0.0, "along": 1.0}
    return {
        "extends": "keep_spot",
        "name": "copies",
        "duration": 1.0,
        "world": {
            "area": {"type": named("box", "Area"), "x_min": -50, "x_max": 50, "y_min": -50, "y_max": 50, "z_min": -90},
            "wind": {"type": named("log_shear", "Wind"), "speed_20ft": 3.0, "wind_from_deg": 270.0},
            "turbulence": {"type": named("dryden", "Turbulence")},
            "gust": {"type": named("discrete", "Gust"), **gust},
            "sky": {"errors": {"type": named("ou", "Errors")},
                    "orbits": {"type": named("nominal_constellation", "Orbits")}},
        },
        "fleets": {"pelicans": {
            "vehicle": {"type": named("pelican", "Vehicle")},
            "battery": {"type": named("lithium_polymer", "Battery"), "voltage_full": 12.5, "voltage_empty": 10.0},
            "controller": {"type": named("waypoint", "Controller")},
            "guidance": {"type": named("route", "Guidance")},
            "sensors": {"gnss": {"type": named("gnss_receiver", "Receiver")}},
        }},
        "task": {"type": named("keep_spot", "Task")},
    }  # fmt: skip


KINDS = {"wind", "turbulence", "gust", "sky", "orbits", "area", "vehicle", "battery", "controller", "guidance",
         "sensor", "task"}  # fmt: skip


@pytest.mark.long
def test_of_every_kind_they_are_taken_in_and_traced(tmp_path: Path):
    scenario = load_scenario(of_every_kind(str(written(tmp_path, COPIES, "copies.py"))))
    assert {part["kind"] for part in scenario.outside} == KINDS


@pytest.mark.long
def test_of_every_kind_they_fly_as_built_in_ones(tmp_path: Path):
    """The same bits."""
    file = str(written(tmp_path, COPIES, "copies.py"))
    found = []
    for scenario in (load_scenario(of_every_kind("")), load_scenario(of_every_kind(file))):
        simulation = qrsim.Simulation(scenario.world(), seed=4)
        simulation.reset()
        simulation.step(ticks=30)
        found.append((simulation.truth.state, simulation.reading.gnss.position_ned, simulation.truth.wind_ned))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
