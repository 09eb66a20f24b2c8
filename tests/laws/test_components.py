"""Laws that hold for every component of the catalogue; a new one is covered by being there."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Sequence
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from component_cases import (
    COMPONENTS,
    EVALUATE,
    GROUPS,
    SLOTS,
    VEHICLES,
    Draws,
    elevation_file,
    evaluate,
    example,
    fields_of,
    inputs,
    options,
    parameters_needed,
    stream_keys,
)
from tests.by_numpy import by_numpy

from qrsim.core.primitives import KERNELS
from qrsim.core.tree import field_info, replace, walk
from qrsim.core.vectors import rotation
from qrsim.errors import ScenarioError
from qrsim.models.gnss.receivers import GnssReading
from qrsim.models.scene.area import StateLimits
from qrsim.models.sensors.contracts import Memoryless
from qrsim.models.sensors.magnetometer import USUAL_FIELD
from qrsim.scenarios import catalogue
from qrsim.scenarios.scenario import load_scenario

WORLDS = (0, 1)
# Frequencies in parts of 2^32, whole turns left out: rounded numbers, and not counts.
FIXED_POINT = ".advance"
every_component = pytest.mark.parametrize(("group", "name"), COMPONENTS, ids=["-".join(case) for case in COMPONENTS])


# Their slopes and batches take seconds to trace in each of their many forms, which their own tests fly or read.
ONE_FORM = [("VEHICLES", "multirotor"), ("VEHICLES", "fixed_wing"), ("SENSORS", "gnss"), ("FILTERS", "ekf")]
# What receivers know of the sky alike, which is no vehicle's own.
SHARED = (".geometry.", ".ids")


# Groups whose slopes and batches take longest to trace.
DEAR = ("VEHICLES", "FILTERS", "CONTROLLERS")


def option_cases(
    options_are_long: bool = False,
    dear: Sequence[str] = (),
    options_nightly: Sequence[tuple[str, str]] = (),
    one_in_four: bool = False,
    nightly: Sequence[tuple[str, str]] = (),
) -> list[Any]:
    """Return every component by its defaults, and with each of its options."""
    cases = []
    for group, name in COMPONENTS:
        for settings in options(group, name):
            chosen = [f"{setting}={option}" for setting, option in settings.items()]
            not_first = name not in list(GROUPS[group])[::4]
            long = options_are_long and (bool(settings) or group in dear or (bool(dear) and not_first))
            marks = (pytest.mark.long,) if long else ()
            # All programs take minutes to compile: of each group, one component in four is compiled before the night.
            at_night = [*nightly, *(options_nightly if settings else ())]
            if (one_in_four and not_first) or (settings and dear) or (group, name) in at_night:
                marks = (pytest.mark.nightly,)
            cases.append(pytest.param(group, name, settings, id="-".join([group, name, *chosen]), marks=marks))
    return cases


# Five doublings of an angle make 32 times as much of its rounding, and a ray at a slant as much as its slope.
ROUNDED = {("TURBULENCES", "dryden_field"): 5e-6, ("SENSORS", "scan"): 1e-5, ("SENSORS", "ideal_scan"): 1e-5}
# Fields of readings that are NaN where a sensor sees nothing.
UNSEEN = dict.fromkeys(("rangefinder", "ideal_rangefinder", "scan", "ideal_scan"), ("range",))
UNSEEN |= {"ranging": ("beacon_range", "vehicle_range")}
UNSEEN |= dict.fromkeys(("optical_flow", "ideal_optical_flow"), ("flow_x", "flow_y", "flow"))
UNSEEN |= dict.fromkeys(("neighbours", "ideal_neighbours"), ("position", "distance", "vehicle", "velocity"))
# Sensors whose truth is rays and pairs, which their own tests compute by hand.
BY_HAND = ("ideal_scan", "ideal_ranging", "ideal_neighbours")
# Tracing a slope takes ten times as long as tracing the values, and a batch three times: the short tier traces one
# component in four of each group.
by_defaults_first = pytest.mark.parametrize(("group", "name", "settings"), option_cases(True, DEAR, ONE_FORM))
by_defaults = pytest.mark.parametrize(("group", "name", "settings"), option_cases(True))
# Backward through the contacts of its feet takes JAX a quarter of a minute.
MULTIROTOR = ("VEHICLES", "multirotor")
by_slopes = pytest.mark.parametrize(
    ("group", "name", "settings"), option_cases(True, DEAR, ONE_FORM, nightly=[MULTIROTOR])
)
every_program = pytest.mark.parametrize(
    ("group", "name", "settings"), option_cases(options_nightly=COMPONENTS, one_in_four=True)
)
every_sensor = pytest.mark.parametrize("name", GROUPS["SENSORS"])


# The older code generator of XLA:CPU compiles in half the time, without optimisation again in half. The laws are about
# what is computed; that the optimised programs obey them too is seen in test_structure.py and test_resume.py.
compiled = partial(
    jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
)


def leaves(tree: Any) -> list[tuple[str, np.ndarray[Any, Any]]]:
    """Return (path, array) of a tree's leaves."""
    return [(jax.tree_util.keystr(path), np.asarray(leaf)) for path, leaf in jax.tree_util.tree_leaves_with_path(tree)]


def stacked(trees: list[Any]) -> Any:
    return jax.tree.map(lambda *parts: np.stack([np.asarray(part) for part in parts]), *trees)


def assert_close(found: Any, expected: Any, relative: float) -> None:
    """Compare two trees leaf by leaf, relative to each leaf's largest magnitude."""
    for (path, got), (_, want) in zip(leaves(found), leaves(expected), strict=True):
        assert got.shape == want.shape, path
        assert got.dtype == want.dtype, path
        if path.endswith(FIXED_POINT):
            got, want = (np.ascontiguousarray(leaf).view(np.int32).astype(np.float64) for leaf in (got, want))
        if not np.issubdtype(want.dtype, np.floating):
            np.testing.assert_array_equal(got, want, err_msg=path)
            continue
        finite = np.isfinite(want)
        np.testing.assert_array_equal(got[~finite], want[~finite], err_msg=path)
        scale = np.max(np.abs(want[finite]), initial=0.0)
        np.testing.assert_allclose(got[finite], want[finite], rtol=0.0, atol=relative * scale, err_msg=path)


def test_every_group_of_the_catalogue_has_laws() -> None:
    assert set(GROUPS) == set(EVALUATE) == set(SLOTS), "a new kind of component needs a case in component_cases.py"
    groups = {name for name, value in vars(catalogue).items() if name.isupper() and isinstance(value, dict) and value}
    assert groups - {"KINDS"} == set(GROUPS)


def computed(group: str, name: str, settings: dict[str, Any] | None = None) -> list[Any]:
    """Return the results of a component in each of WORLDS, traced once and evaluated by NumPy."""
    return _computed(group, name, tuple((settings or {}).items()))


@cache
def _computed(group: str, name: str, settings: tuple[tuple[str, Any], ...]) -> list[Any]:
    component = example(group, name, **dict(settings))
    return by_numpy(partial(evaluate, group), [(component, inputs(world), stream_keys(world)) for world in WORLDS])


@cache
def traced(name: str) -> Any:
    """Return states and readings of a sensor with shapes and types in place of numbers, which costs no compilation."""
    sensor = example("SENSORS", name)
    return jax.eval_shape(lambda given, keys: evaluate("SENSORS", sensor, given, keys), inputs(0), stream_keys(0))


@by_defaults
def test_outputs_are_finite(group: str, name: str, settings: dict[str, Any]) -> None:
    for found in computed(group, name, settings):
        seen: dict[str, bool] = {}
        for path, leaf in leaves(found["results"]):
            lacks = re.fullmatch(r"\['(first|second|start|after)'\]\.([a-z_]+).*", path)
            if lacks and lacks[2] in UNSEEN.get(name, ()):
                assert not np.isinf(leaf).any(), path
                seen[lacks[1]] = seen.get(lacks[1], False) or bool(np.isfinite(leaf).any())
                continue
            assert np.isfinite(leaf).all(), path
        # Whichever other way they look, they see something by default.
        assert settings or all(seen.values())


@pytest.fixture
def eager_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluate kernels operation by operation, too; JAX would compile each, and round it as that compiler pleases."""
    for kernel in KERNELS.values():
        monkeypatch.setattr(kernel.primitive, "impl", kernel.body)


@every_program
@pytest.mark.long
@pytest.mark.usefixtures("eager_kernels")
def test_eager_and_jitted_agree(group: str, name: str, settings: dict[str, Any]) -> None:
    given = example(group, name, **settings), inputs(WORLDS[0]), stream_keys(WORLDS[0])
    assert_close(compiled(partial(evaluate, group))(*given), evaluate(group, *given), ROUNDED.get((group, name), 1e-6))


@by_defaults_first
def test_a_batch_of_worlds_is_each_world_alone(group: str, name: str, settings: dict[str, Any]) -> None:
    """The same values to 1e-6, and the same noise to the bit."""
    alone = stacked(computed(group, name, settings))
    given, keys = stacked([inputs(world) for world in WORLDS]), stacked([stream_keys(world) for world in WORLDS])
    together = jax.vmap(partial(evaluate, group), in_axes=(None, 0, 0))
    (batch,) = by_numpy(together, [(example(group, name, **settings), given, keys)])
    assert_close(batch["results"], alone["results"], ROUNDED.get((group, name), 1e-6))
    for (path, got), (_, want) in zip(leaves(batch["noise"]), leaves(alone["noise"]), strict=True):
        np.testing.assert_array_equal(got, want, err_msg=path)


def total(group: str, component: Any, given: Any, keys: Any) -> Any:
    """Return the sum of all floating-point results of a component."""
    found = jax.tree.leaves(evaluate(group, component, given, keys)["results"])
    return sum(jnp.sum(leaf) for leaf in found if jnp.issubdtype(leaf.dtype, jnp.floating))


@by_slopes
def test_slopes_in_every_parameter_are_finite(group: str, name: str, settings: dict[str, Any]) -> None:
    world = WORLDS[-1]
    given = example(group, name, **settings), inputs(world), stream_keys(world)
    (slopes,) = by_numpy(jax.grad(partial(total, group), allow_int=True), [given])
    for path, leaf in leaves(slopes):
        if np.issubdtype(leaf.dtype, np.floating):
            assert np.isfinite(leaf).all(), path


@pytest.mark.long
def test_a_multirotor_has_a_finite_slope_along_all_parameters_at_once() -> None:
    """Forward; the nightly tests go backward to each."""

    def slope(component: Any, given: Any, keys: Any) -> Any:
        def along(leaf: Any) -> Any:
            is_float = jnp.issubdtype(leaf.dtype, jnp.floating)
            return jnp.ones_like(leaf) if is_float else np.zeros(leaf.shape, jax.dtypes.float0)

        own = jax.tree.map(jnp.asarray, component)
        return jax.jvp(lambda each: total(MULTIROTOR[0], each, given, keys), (own,), (jax.tree.map(along, own),))[1]

    world = WORLDS[-1]
    (found,) = by_numpy(slope, [(example(*MULTIROTOR), inputs(world), stream_keys(world))])
    assert np.isfinite(found)
    assert found != 0.0


# A placement is of a fleet as a whole.
OF_A_FLEET = [case for case in COMPONENTS if SLOTS[case[0]].startswith("fleets.") and case[0] != "PLACEMENTS"]
IN_LISTS = [
    pytest.param(*case, id="-".join(case), marks=() if case in OF_A_FLEET[::4] else pytest.mark.long)
    for case in OF_A_FLEET
]


@pytest.mark.parametrize(("group", "name"), IN_LISTS)
def test_numbers_may_differ_from_vehicle_to_vehicle(group: str, name: str) -> None:
    """With a list in place of each number, every vehicle is as in a fleet where all have its numbers."""
    component, given, keys = example(group, name), inputs(0), stream_keys(0)
    factors = np.linspace(0.8, 1.0, VEHICLES).astype(np.float32)
    # What a world derives, as the places of beacons, is no number of a vehicle.
    kept = {field.name: getattr(component, field.name) for field in dataclasses.fields(component)
            if field_info(field).derived}  # fmt: skip
    numbers = replace(component, **dict.fromkeys(kept))
    lists = replace(jax.tree.map(lambda leaf: leaf * factors, numbers), **kept)
    run = partial(evaluate, group)
    (together,) = by_numpy(run, [(lists, given, keys)])
    own = [replace(jax.tree.map(lambda leaf, f=factor: leaf * f, numbers), **kept) for factor in factors]
    for i, alone in enumerate(by_numpy(run, [(each, given, keys) for each in own])):
        for (path, got), (_, want) in zip(leaves(together["results"]), leaves(alone["results"]), strict=True):
            if any(part in path for part in SHARED):
                continue
            assert got.shape == want.shape, path
            scale = np.max(np.abs(want[np.isfinite(want)]), initial=0.0)
            np.testing.assert_allclose(got[..., i], want[..., i], rtol=0.0, atol=1e-6 * scale, err_msg=path)


@by_defaults
def test_what_is_drawn_is_what_is_declared(group: str, name: str, settings: dict[str, Any]) -> None:
    """Too few would fail in a simulation, too many would be drawn for nothing, and no pair is drawn twice."""
    component = example(group, name, **settings)
    draws = Draws(stream_keys(0), np.float32)
    jax.eval_shape(lambda given: EVALUATE[group](component, given, draws), inputs(0))
    for call, recorder in draws.recorders.items():
        pairs = [pair for drawn in recorder.pairs for pair in drawn]
        assert len(set(pairs)) == len(pairs), f"{call} draws the same numbers twice"
        # What is drawn once an episode for a whole world is not declared.
        if call == "field":
            continue
        if group in ("SENSORS", "TURBULENCES", "VEHICLES") and not (group == "SENSORS" and component.draws_alone):
            assert recorder.rows == [], f"{call}: whoever declares normals is handed nothing else"
            first = getattr(component, "first_normals", 0) if call == "init" else 0
            assert sum(recorder.counts) == (first or component.normals), call


@every_component
def test_parameters_have_unit_meaning_and_a_default_within_bounds(group: str, name: str) -> None:
    for field, default, info in fields_of(GROUPS[group][name]):
        assert info.doc, f"{field}: no doc"
        is_number = isinstance(default, int | float) and not isinstance(default, bool)
        if not info.static or is_number:
            assert info.unit, f"{field}: no unit; a plain number has the unit '1'"
        if is_number:
            assert info.minimum is None or default >= info.minimum, field
            assert info.maximum is None or default <= info.maximum, field
            assert info.above is None or default > info.above, field


def test_the_state_limits_have_units_too() -> None:
    for field, default, info in fields_of(StateLimits):
        assert info.unit, field
        assert info.doc, field
        assert info.above is not None
        if default is None:
            assert info.nullable
            continue
        assert default > info.above
        assert info.maximum is None or default <= info.maximum


def scenario_with(group: str, part: Any) -> dict[str, Any]:
    """Return a valid scenario with one part replaced."""
    sensors = {
        "gnss": {"type": "ideal_gnss"},
        "height": {"type": "ideal_barometer"},
        "attitude": {"type": "ideal_attitude"},
        "force": {"type": "ideal_accelerometer"},
    }
    # The wind is there for the turbulence to inherit from.
    wind = {"type": "log_shear", "speed_20ft": 3.0, "wind_from_deg": 10.0}
    fleet = {"sensors": sensors, "vehicles": [{"position_ned": [30.0, 30.0, -10.0]}]}
    if group == "GUIDANCE":
        # Between them they take whatever a guidance gives.
        mission = {"type": "cascade", "feed": "truth"}
        fleet["controller"] = mission if part["type"] == "mission" else {"type": "offboard"}
    if group in ("CONTROLLERS", "GUIDANCE") and part["type"] == "none":
        fleet |= {"vehicle": {"type": "fixed_point"}, "controller": {"type": "none"}}
    if "rover" in part.get("type", ""):
        fleet |= {"vehicle": {"type": "rover"}, "vehicles": [{"position_ned": [30.0, 30.0, 0.0]}]}
        fleet["controller"] = {"type": "rover"}
    if part.get("type") == "fixed_wing":
        sensors["air"] = {"type": "ideal_airspeed"}
        fleet |= {"vehicle": {"type": "fixed_wing"}, "controller": {"type": "fixed_wing"}}
    if group == "FILTERS":
        sensors["rates"] = {"type": "ideal_gyroscope"}
    if group == "BATTERIES" and part["type"] == "lithium_cells":
        fleet["vehicle"] = {"type": "multirotor"}
    beacons = [{"name": "mast", "position_ned": [5.0, 5.0, -3.0]}]
    world: dict[str, Any] = {"wind": wind, "obstacles": [None], "sky": {}, "beacons": beacons}
    if group == "TASKS":
        fleet["controller"] = {"type": "offboard"}
        sensors |= {"camera": {"type": "camera"}, "concentration": {"type": "concentration"}}
        world |= {"persons": {"type": "lying"}, "plume": {"type": "gaussian"}}
    leads = part.get("type") == "keep_formation"
    if leads:
        world["radio"] = {"preset": "sphere"}
    still = {"controller": {"type": "waypoint", "feed": "truth"}, "vehicles": [{"position_ned": [0.0, 0.0, -20.0]}]}
    if group == "UPDRAFTS":
        # Wide enough for the widest thermals, over hills for ridges, and with a mast that has a wake.
        side = 1000.0 if part["type"] == "ridge_lift" else 2000.0
        world["area"] = {"type": "box", **{f"{axis}_min": -side for axis in "xyz"}, "x_max": side, "y_max": side}
        ground = {"type": "dem", "file": elevation_file()} if part["type"] == "ridge_lift" else {"type": "flat"}
        mast = {"type": "cylinder", "x": 0.0, "y": 0.0, "radius": 1.0, "z_min": -1001.0}
        world |= {"updrafts": [part], "ground": ground, "obstacles": [mast]}
    content: dict[str, Any] = {
        "name": "x",
        "duration": 1.0,
        "world": world,
        "fleets": {"a": fleet} | ({"b": still} if leads else {}),
    }
    *way, last = SLOTS[group].split(".")
    target: Any = content
    for step in way:
        target = target[step]
    target[0 if isinstance(target, list) else last] = part
    if content["world"]["obstacles"] == [None]:
        del content["world"]["obstacles"]
    return content


@every_component
def test_a_scenario_can_name_it_and_an_unknown_parameter_is_rejected_with_a_suggestion(group: str, name: str) -> None:
    # A turbulence takes what it lacks from the wind.
    given = {"type": name} | ({} if group == "TURBULENCES" else parameters_needed(group, name))
    load_scenario(scenario_with(group, given))
    known = [field for field, _, _ in fields_of(GROUPS[group][name]) if "." not in field]
    misspelt = f"{known[0]}x" if known else "speed"
    with pytest.raises(ScenarioError) as caught:
        load_scenario(scenario_with(group, {**given, misspelt: 1.0}))
    suggestion = f"; did you mean '{known[0]}'?" if known else ""
    assert caught.value.problems == [f"{SLOTS[group]}.{misspelt}: no such parameter of '{name}'{suggestion}"]


@every_component
def test_a_scenario_accepts_bounds_and_rejects_what_is_beyond(group: str, name: str) -> None:
    given = {"type": name, **parameters_needed(group, name)}
    for field, _, info in fields_of(GROUPS[group][name]):
        if info.static or "." in field:
            continue
        where = rf"{SLOTS[group]}\.{field}" + (rf"\.{info.length - 1}" if info.length else "")

        def part(value: float, length: int = info.length) -> Any:
            return [0.0] * (length - 1) + [value] if length else value

        for bound, beyond in ((info.minimum, -1.0), (info.maximum, 1.0), (info.above, -1.0)):
            if bound is not None:
                with pytest.raises(ScenarioError, match=rf"{where}: .* is out of range"):
                    load_scenario(scenario_with(group, {**given, field: part(bound + beyond)}))
        for bad in (float("nan"), float("inf")):
            with pytest.raises(ScenarioError, match=rf"{where}: {bad} is not a finite number"):
                load_scenario(scenario_with(group, {**given, field: part(bad)}))


@every_sensor
def test_a_sensor_reads_only_what_a_scene_offers(name: str) -> None:
    sensor: Any = GROUPS["SENSORS"][name]
    assert set(sensor.reads) <= set(inputs(0)["scene"])
    for call, own in ((sensor.init, {"self", "draw"}), (sensor.step, {"self", "state", "draw"})):
        # That of sensors without a state hands on to ``init`` whatever it is handed.
        if call is not Memoryless.step:
            assert set(inspect.signature(call).parameters) - own == set(sensor.reads)


@every_sensor
def test_a_sensor_can_hold_its_reading_between_periods(name: str) -> None:
    """State and reading keep structure, shape and type, so that one program can skip or take a step."""
    results = traced(name)["results"]
    for before, after in (("start", "after"), ("first", "second")):
        shapes = [jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), results[which]) for which in (before, after)]
        assert shapes[0] == shapes[1]
    assert all(leaf.shape == (VEHICLES,) for leaf in jax.tree.leaves(results["second"]))
    assert example("SENSORS", name).period > 0.0


@every_sensor
def test_every_quantity_of_a_reading_has_a_unit_and_a_meaning(name: str) -> None:
    for field, _, info in walk(traced(name)["results"]["second"]):
        assert info.unit, field
        assert info.doc, field


def test_every_sensor_has_an_ideal_form_that_says_the_truth() -> None:
    """It has the same reading and draws nothing; its inputs are the same but for what single precision leaves out."""
    kinds: dict[bool, set[Any]] = {True: set(), False: set()}
    for name in GROUPS["SENSORS"]:
        sensor: Any = GROUPS["SENSORS"][name]
        # No hill stands in the way of the ideal receiver's satellites.
        reads = tuple(what for what in sensor.reads if what not in ("position_low_ned", "ground", "skyline"))
        # What a receiver says of its own accuracy has no truth.
        said = type(traced(name)["results"]["second"])
        kinds[name.startswith("ideal_")].add((GnssReading if issubclass(said, GnssReading) else said, reads))
        if name.startswith("ideal_"):
            assert jax.tree.leaves(traced(name)["noise"]) == []
            if name in BY_HAND:
                continue
            found = computed("SENSORS", name)[0]
            later = inputs(0)["later"]
            truth = {
                **later,
                "height": -later["position_ned"].z,
                "concentration": later["surroundings"].concentration(later["position_ned"]),
                "taken_at_ned": later["position_ned"],
                "taken_attitude": later["attitude"],
                "true_airspeed": later["velocity_body"].x - rotation(later["attitude"]).forward.dot(later["wind_ned"]),
                "field_body": rotation(later["attitude"]).to_body(USUAL_FIELD),
                "status": np.zeros(VEHICLES, np.float32)
                + (name == "ideal_optical_flow") * np.array([2.0, 0.0, 0.0], np.float32),
            }
            reading = found["results"]["second"]
            named = [field for field in reading.__dataclass_fields__ if field in truth]
            assert named, name
            for field in named:
                # Some take arithmetic, which this program and that of the sensor may round otherwise.
                computed_too = field in ("concentration", "field_body", "true_airspeed")
                assert_close(getattr(reading, field), truth[field], 1e-6 if computed_too else 0.0)
    assert kinds[True] == kinds[False]
