"""The built-in scenarios, the YAML they are written back as, and the JSON schema."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.interface.sensor_reading import PICTURE_FIELDS
from qrsim.scenarios import catalogue
from qrsim.scenarios.reading import parse_yaml
from qrsim.scenarios.scenario import built_in_names, json_schema, load_scenario

# Of a family one variant, and at night: by day these fly in tests/envs.
FAMILIES = ("cats_and_mouse/1C", "search_and_rescue/2B", "plume_mapping/3F")
FLOWN = [
    *(name for name in built_in_names() if "/" not in name),
    *(pytest.param(name, marks=pytest.mark.nightly) for name in FAMILIES),
]


@pytest.mark.parametrize("name", FLOWN)
@pytest.mark.long
def test_a_built_in_scenario_flies_for_twenty_seconds(name: str) -> None:
    simulation = qrsim.load(name, seed=1)
    start = simulation.reset()
    assert simulation.valid.all()
    simulation.step(ticks=round(20.0 / simulation.world.time_step))
    assert simulation.time == pytest.approx(20.0)
    assert simulation.valid.all(), simulation.reasons
    assert np.isfinite(simulation.truth.state[:, :12]).all()
    # What stands or drives has no thrust.
    lifted = [fleet.vehicle.default_controller not in ("none", "rover") for fleet in simulation.world.fleets]
    sizes = [fleet.size for fleet in simulation.world.fleets]
    np.testing.assert_array_equal(np.isfinite(simulation.truth.state[:, 12]), np.repeat(lifted, sizes))
    for fleet in start.fleets:
        for sensor in simulation.reading[fleet].sensors:
            reading = getattr(simulation.reading[fleet], sensor)
            # A picture is NaN beyond its grid.
            for field in [field for field in reading.fields if field not in PICTURE_FIELDS]:
                assert np.isfinite(getattr(reading, field)).all(), (fleet, sensor, field)


@pytest.mark.parametrize("name", built_in_names())
def test_a_scenario_written_as_yaml_is_the_same_scenario(name: str) -> None:
    scenario = load_scenario(name)
    text = scenario.to_yaml()
    again = load_scenario(parse_yaml(text, "again.yaml"))
    assert again.spec == scenario.spec
    assert again.to_yaml() == text


@pytest.mark.parametrize("name", built_in_names())
def test_every_default_is_written_out(name: str) -> None:
    content = parse_yaml(load_scenario(name).to_yaml(), "all.yaml")
    for fleet in content["fleets"].values():
        assert {"vehicle", "controller", "guidance", "limits", "sensors", "vehicles"} <= set(fleet)
        # What stands has neither mass nor loops, and those of rovers and wings are no parts of their own.
        assert "mass" in fleet["vehicle"] or fleet["vehicle"]["type"] == "fixed_point"
        if fleet["controller"]["type"] in ("none", "rover", "fixed_wing"):
            continue
        loops = [part for part in fleet["controller"].values() if isinstance(part, dict)]
        # The loops of a published controller, the filter of a cascade.
        assert any("kp" in loop or "bias_gain" in loop for loop in loops)
    assert {"area", "wind", "turbulence", "sky", "collision_distance"} <= set(content["world"])


@pytest.mark.parametrize("name", ["1e3", "007", "on", "null", "1.5", "2026-06-21"])
def test_a_name_that_looks_like_something_else_survives_the_round_trip(name: str) -> None:
    content: dict[str, Any] = {
        "name": name,
        "fleets": {
            name: {"controller": {"type": "waypoint", "feed": "truth"}, "vehicles": [{"position_ned": [0.0] * 3}]}
        },
    }
    if "." in name:
        content["fleets"] = {"a": content["fleets"][name]}
    scenario = load_scenario(content)
    assert load_scenario(parse_yaml(scenario.to_yaml(), "again.yaml")).spec == scenario.spec


# Area (x, y, z limits), starts, first waypoint of the first vehicle: the numbers of the reference implementation.
SMALL_AREA = (-10.0, 20.0, -10.0, 10.0, -20.0, 0.0)
SIMPLE_TASKS: dict[str, tuple[tuple[float, ...], list[list[float]], list[list[float]]]] = {
    "keep_spot": (SMALL_AREA, [[0.0, 0.0, -10.0]], []),
    "keep_spot_10": (
        (-120.0, 120.0, -10.0, 10.0, -40.0, 0.0),
        [[20.0 * i, 0.0, -10.0] for i in range(-4, 6)],
        [],
    ),
    "goto_waypoint": ((-70.0, 70.0, -70.0, 70.0, -50.0, 0.0), [[0.0, 0.0, -10.0]], [[-50.0, -50.0, -10.0]]),
    "keep_velocity": (SMALL_AREA, [[0.0, 0.0, -10.0]], []),
    "free_flight": ((-15.0, 80.0, -15.0, 15.0, -20.0, 0.0), [[6.0, -8.0, -9.0]], []),
}


@pytest.mark.parametrize("name", SIMPLE_TASKS)
def test_a_simple_task_has_the_published_numbers(name: str) -> None:
    spec = load_scenario(name).spec
    area, starts, waypoints = SIMPLE_TASKS[name]
    (fleet,) = spec.fleets.values()
    assert spec.name == name
    assert tuple(getattr(spec.world.area, f"{axis}_{end}") for axis in "xyz" for end in ("min", "max")) == area
    assert [vehicle.position_ned for vehicle in fleet.vehicles] == starts
    assert fleet.vehicles[0].waypoints_ned == waypoints
    if name == "free_flight":
        assert (spec.world.wind.type, spec.world.turbulence.type, fleet.limits.rate) == ("calm", "still", 2.0)
        assert all(sensor.type.startswith("ideal_") for sensor in fleet.sensors.values())
    else:
        assert spec.world.turbulence.speed_20ft == 2.0
        assert not any(sensor.type.startswith("ideal_") for sensor in fleet.sensors.values())
    if name == "keep_velocity":
        assert (spec.world.wind.speed_20ft, fleet.controller.type) == (2.5, "velocity")
        assert spec.world.wind.wind_from_rad == spec.world.turbulence.wind_from_rad == pytest.approx(np.radians(45.0))
    else:
        assert spec.world.wind.type == "calm"


def resolved(schema: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    reference = part.get("$ref")
    return schema["$defs"][reference.rpartition("/")[2]] if reference else part


def test_the_json_schema_is_json_with_units_and_bounds() -> None:
    schema = json_schema()
    assert json.loads(json.dumps(schema)) == schema
    assert schema["type"] == "object"
    assert {"name", "fleets"} <= set(schema["required"])
    assert schema["additionalProperties"] is False
    mass = schema["$defs"]["pelican"]["properties"]["mass"]
    assert (mass["unit"], mass["default"]) == ("kg", 1.68)
    # One for all vehicles of a fleet, or one for each.
    one, each = mass["oneOf"]
    assert (one, each["type"]) == (each["items"], "array")
    assert (one["type"], one["exclusiveMinimum"]) == ("number", 0.0)
    speed = schema["$defs"]["log_shear"]["properties"]["speed_20ft"]
    assert (speed["unit"], speed["minimum"], speed["maximum"]) == ("m/s", 0.0, 50.0)
    assert "20 ft" in speed["description"]


def test_the_json_schema_knows_every_component_of_the_catalogue() -> None:
    known = json.dumps(json_schema())
    for group in vars(catalogue).values():
        if isinstance(group, dict) and group and all(isinstance(item, type) for item in group.values()):
            for name in group:
                assert f'"const": "{name}"' in known, name


def test_the_json_schema_names_types_by_their_key_where_several_keys_have_one() -> None:
    schema = json_schema()
    assert not [name for name in schema["$defs"] if "__" in name]
    assert schema["properties"]["task"]["discriminator"]["mapping"]["none"] == "#/$defs/task_none"
    wings = {name for name in schema["$defs"] if name.endswith("fixed_wing")}
    assert wings == {"vehicle_fixed_wing", "controller_fixed_wing", "guidance_fixed_wing"}
    referred = set(re.findall(r'"#/\$defs/(\w+)"', json.dumps(schema)))
    assert referred == set(schema["$defs"])


def test_the_json_schema_takes_angles_in_degrees_too() -> None:
    wind = json_schema()["$defs"]["log_shear"]
    assert {"wind_from_rad", "wind_from_deg"} <= set(wind["properties"])
    assert "wind_from_rad" not in wind["required"]
    assert "speed_20ft" in wind["required"]


def test_the_json_schema_has_a_description_of_every_parameter() -> None:
    schema = json_schema()
    for title, part in [("scenario", schema), *schema["$defs"].items()]:
        for name, entry in part.get("properties", {}).items():
            assert entry.get("description"), f"{title}.{name}"
