"""Scenarios from Python against the same ones in YAML."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import jax
import numpy as np
import pytest

import qrsim
from qrsim.control import CascadeController, HeightLoop, VelocityController, WaypointController
from qrsim.errors import ScenarioError, UsageError
from qrsim.models.atmosphere.turbulence import DrydenFirstOrder
from qrsim.models.atmosphere.wind import LogShear
from qrsim.models.gnss.interference import Jammer
from qrsim.models.gnss.receivers import GnssReceiver, OrnsteinUhlenbeckErrors
from qrsim.models.gnss.sensor import Gnss
from qrsim.models.scene.fence import PolygonArea
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle
from qrsim.models.sensors.imu import Imu
from qrsim.models.vehicles.battery import LithiumPolymer
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.scenarios.making import make_scenario, make_world
from qrsim.scenarios.scenario import load_scenario
from qrsim.scenarios.sensor_sets import SETS
from qrsim.simulation.simulation import Simulation
from qrsim.tasks import KeepSpot

ROUTES = {"position_ned": [0.0, 0.0, -10.0], "waypoints_ned": [[-50.0, -50.0, -10.0]]}
PATROL = {
    (-60.0, -60.0, -20.0): [[-60, -20, -20], [-20, -20, -20], [-20, -60, -20], [-60, -60, -20]],
    (-60.0, 20.0, -30.0): [[-60, 60, -30], [-20, 60, -30], [-20, 20, -30], [-60, 20, -30]],
    (-20.0, -20.0, -40.0): [[-20, 20, -40], [20, 20, -40], [20, -20, -40], [-20, -20, -40]],
    (20.0, -60.0, -50.0): [[20, -20, -50], [60, -20, -50], [60, -60, -50], [20, -60, -50]],
    (20.0, 20.0, -60.0): [[20, 60, -60], [60, 60, -60], [60, 20, -60], [20, 20, -60]],
}
NARROW = {"type": "box", "x_min": -10, "x_max": 20, "y_min": -10, "y_max": 10, "z_min": -20, "z_max": 0}


PLAIN = {
    "gnss": "gnss_receiver",
    "barometer": "barometer",
    "attitude": "attitude_estimator",
    "gyroscope": "gyroscope",
    "accelerometer": "accelerometer",
}


def gusts(bearing_rad: float) -> DrydenFirstOrder:
    return DrydenFirstOrder(speed_20ft=2.0, wind_from_rad=bearing_rad)  # type: ignore[arg-type]


def keep_spot() -> Any:
    return make_scenario(
        fleets={"pelicans": {"vehicles": [[0, 0, -10]], "sensors": PLAIN, "controller": "waypoint"}},
        name="keep_spot",
        area=NARROW,
        turbulence=gusts(0.0),
        sky={"errors": {"type": "gauss_markov_2"}},
        task=KeepSpot(),
    )


def keep_velocity() -> Any:
    fleet = {"vehicles": np.array([[0, 0, -10]]), "sensors": PLAIN, "controller": VelocityController()}
    return make_scenario(
        fleets={"pelicans": fleet},
        name="keep_velocity",
        area=NARROW,
        turbulence=gusts(np.pi / 4),
        wind=LogShear(speed_20ft=np.float32(2.5), wind_from_rad=np.pi / 4),
        sky={"errors": {"type": "gauss_markov_2"}},
        task={"type": "keep_velocity", "fleet": "pelicans"},
    )


def goto_waypoint() -> Any:
    area = {"type": "box", "x_min": -70, "x_max": 70, "y_min": -70, "y_max": 70, "z_min": -50, "z_max": 0}
    return make_scenario(
        extends="keep_spot",
        name="goto_waypoint",
        area=area,
        fleets={"pelicans": {"vehicles": [ROUTES]}},
        task={"type": "reach_waypoint"},
    )


def free_flight() -> Any:
    area = {"type": "box", "x_min": -15.0, "x_max": 80.0, "y_min": -15.0, "y_max": 15.0, "z_min": -20.0, "z_max": 0.0}
    fleet = {"vehicles": [(6.0, -8.0, -9.0)], "controller": "offboard", "limits": {"rate": 2.0}}
    return make_scenario(fleets={"pelicans": fleet}, name="free_flight", area=area)


def patrol_plain() -> Any:
    bounds = {"x_min": -200.0, "x_max": 200.0, "y_min": -200.0, "y_max": 200.0, "z_min": -100.0, "z_max": 0.0}
    fleet = {
        "vehicles": [{"position_ned": start, "waypoints_ned": route} for start, route in PATROL.items()],
        "vehicle": Quadrotor(),
        "controller": CascadeController(speed_limit=5.0, tilt_limit=0.67),  # type: ignore[arg-type]
        "guidance": {"type": "route", "acceptance_radius": 3.0},
        "sensors": {**PLAIN, "gnss": GnssReceiver(range_noise_std=0.02)},  # type: ignore[arg-type]
    }
    return make_scenario(
        fleets={"pelicans": fleet},
        name="patrol_plain",
        duration=120.0,
        start_time=datetime(2026, 6, 21, 10, tzinfo=UTC),
        site={"latitude_deg": 51.7119, "longitude_deg": -0.21052, "height": 0.0},
        area={"type": "box", **bounds},
        wind=LogShear(speed_20ft=5.0, wind_from_rad=np.radians(225.0)),
        turbulence="dryden_first_order",
        sky={"errors": OrnsteinUhlenbeckErrors(std=1.5, time_constant=2000.0)},
        collision_distance=2.0,
    )


class TestAsInYaml:
    @pytest.mark.parametrize("make", [keep_spot, keep_velocity, goto_waypoint, free_flight, patrol_plain])
    def test_same_scenario_and_world(self, make: Any):
        """All but the description; its numbers are equal to the last bit, its structure is one."""
        mine, theirs = make(), load_scenario(make.__name__)
        own = mine.spec.model_dump() | {"description": theirs.spec.description}
        assert own == theirs.spec.model_dump()
        for precision in ("float32", "float64"):
            leaves, structure = jax.tree.flatten(mine.world(precision))
            others, other_structure = jax.tree.flatten(theirs.world(precision))
            assert structure == other_structure
            for leaf, other in zip(leaves, others, strict=True):
                np.testing.assert_array_equal(leaf, other)

    def test_their_runs_are_the_same_to_the_bit(self):
        found = []
        for scenario in (free_flight(), load_scenario("free_flight")):
            simulation = Simulation(scenario.world(), seed=7)
            simulation.reset()
            simulation.step(ticks=100)
            found.append(simulation.state)
        jax.tree.map(np.testing.assert_array_equal, *found)

    def test_it_can_be_saved_as_yaml_and_loaded(self, tmp_path):
        file = tmp_path / "mine.yaml"
        file.write_text(patrol_plain().to_yaml())
        assert load_scenario(file).spec == patrol_plain().spec


class TestParts:
    def test_a_single_fleet(self):
        scenario = make_scenario([[0, 0, -10], {"position_ned": [8, 0, -12], "name": "b"}], controller="velocity")
        (fleet,) = scenario.spec.fleets.values()
        assert list(scenario.spec.fleets) == ["vehicles"]
        assert [vehicle.position_ned for vehicle in fleet.vehicles] == [[0.0, 0.0, -10.0], [8.0, 0.0, -12.0]]
        assert (fleet.vehicles[1].name, fleet.controller.type, fleet.guidance.type) == ("b", "velocity", "velocity")
        assert {name: sensor.type for name, sensor in fleet.sensors.items()} == {
            name: sensor["type"] for name, sensor in SETS["ideal"].items()
        }
        assert scenario.name == "experiment"

    def test_what_goes_with_noisy_sensors(self):
        """A filter, and gusts that neighbours share where the wind says how strong; what is given counts."""
        wind = {"type": "log_shear", "speed_20ft": 5.0, "wind_from_deg": 90.0}

        def parts(**given: Any) -> tuple[str | None, str]:
            spec = make_scenario([[0, 0, -10]], sensors="noisy", **given).spec
            estimator = spec.fleets["vehicles"].estimator
            return None if estimator is None else estimator.type, spec.world.turbulence.type

        assert parts() == ("ekf", "still")
        assert parts(wind=wind) == ("ekf", "dryden_field")
        assert parts(wind=wind, turbulence="dryden", estimator="complementary") == ("complementary", "dryden")
        assert parts(estimator=None) == (None, "still")
        # As hover has it: what the filter takes the sensors' errors to be is left to the sensors.
        mine = make_scenario([[0, 0, -10]], sensors="noisy").spec.fleets["vehicles"]
        hover = load_scenario("hover").spec.fleets["pelicans"]
        assert mine.estimator == hover.estimator
        assert mine.sensors == hover.sensors
        assert mine.estimator.accelerometer_bias_std is None  # type: ignore[union-attr]
        still = make_scenario([[0, 0, -10]], sensors="ideal", wind=wind).spec
        assert (still.world.turbulence.type, still.fleets["vehicles"].estimator) == ("still", None)

    def test_sensors(self):
        noisy = make_scenario([[0, 0, -10]], sensors="noisy").spec.fleets["vehicles"].sensors
        assert [sensor.type for sensor in noisy.values()] == ["gnss", "imu", "magnetometer", "barometer"]
        named = make_scenario(
            [[0, 0, -10]], sensors={"height": "barometer"}, controller={"type": "waypoint", "feed": "truth"}
        )
        assert {name: sensor.type for name, sensor in named.spec.fleets["vehicles"].sensors.items()} == {
            "height": "barometer"
        }
        none = make_scenario([[0, 0, -10]], sensors={}, controller={"type": "waypoint", "feed": "truth"})
        assert none.spec.fleets["vehicles"].sensors == {}

    def test_objects_in_every_place(self):
        square = PolygonArea(north=np.array([-20.0, 20, 20, -20]), east=np.array([-20.0, -20, 20, 20]), z_min=-50.0)  # type: ignore[arg-type]
        scenario = make_scenario(
            [[0, 0, -10], [5, 0, -10]],
            area=square,
            obstacles=[BoxObstacle(8.0, 9.0, 8.0, 9.0, -10.0), CylinderObstacle(-8.0, -8.0, 1.0, -10.0)],  # type: ignore[arg-type]
            vehicle=Quadrotor(mass=np.array([1.6, 1.8])),  # type: ignore[arg-type]
            battery=LithiumPolymer(),
            controller=WaypointController(height=HeightLoop(kp=0.04)),  # type: ignore[arg-type]
        )
        world, fleet = scenario.spec.world, scenario.spec.fleets["vehicles"]
        assert world.area.corners_ned == [[-20, -20], [20, -20], [20, 20], [-20, 20]]
        assert world.area.z_min == -50.0
        assert [obstacle.type for obstacle in world.obstacles] == ["box", "cylinder"]
        assert fleet.vehicle.mass == [1.6, 1.8]
        assert (fleet.battery.type, fleet.controller.height.kp) == ("lithium_polymer", 0.04)
        built = scenario.world()
        np.testing.assert_array_equal(built.area.east, np.float32([-20, -20, 20, 20]))

    def test_extending(self):
        """What is left out is as it is there: the sensors stay noisy, the vehicles where they are."""
        scenario = make_scenario(extends="keep_spot", wind="calm", fleets={"pelicans": {"controller": "velocity"}})
        expected = load_scenario({"extends": "keep_spot", "name": "experiment"}).spec
        fleet, parent = scenario.spec.fleets["pelicans"], expected.fleets["pelicans"]
        assert fleet.sensors == parent.sensors
        assert fleet.vehicles == parent.vehicles
        assert fleet.controller.type == "velocity"
        assert scenario.spec.world == expected.world
        assert make_scenario(extends="keep_spot").spec == expected

    def test_world_of_both_precisions(self):
        for precision in ("float32", "float64"):
            world = make_world([[0, 0, -10]], precision=precision)
            assert world.fleets[0].start.position_ned.x.dtype == precision
        with pytest.raises(UsageError, match="precision: 'float23' is not known; did you mean"):
            make_world([[0, 0, -10]], precision="float23")
        assert qrsim.make_world is make_world


class TestBadInput:
    @pytest.mark.parametrize(
        ("parts", "message"),
        [
            ({}, "give either vehicles or fleets"),
            ({"vehicles": [[0, 0, -10]], "fleets": {}}, "give either vehicles or fleets"),
            ({"vehicles": [[0, 0, -10]], "windy": "calm"}, "no part is called 'windy'; did you mean 'wind'"),
            ({"fleets": {"a": {"vehicles": [[0, 0, -10]]}}, "sensors": "noisy"}, "sensors is a part of a fleet"),
            ({"fleets": {"a": {"sensor": "noisy"}}}, "fleets.a: no part is called 'sensor'; did you mean 'sensors'"),
            ({"fleets": {"a": [[0, 0, -10]]}}, r"fleets.a: expected a dict, found \[\[0"),
            ({"vehicles": 5}, "vehicles: expected a list of vehicles, found 5"),
            ({"vehicles": {"position_ned": [0, 0, -10]}}, "expected a list of vehicles"),
            ({"vehicles": [[0, 0, -10]], "sensors": "noisey"}, "'noisey'; did you mean 'noisy'"),
            ({"vehicles": [[0, 0, -10]], "sensors": ["gnss"]}, "expected a dict or the name of a set"),
            ({"vehicles": [[0, 0, -10]], "extends": "keep_spot"}, "with extends give fleets"),
            ({"extends": "keep_spit"}, "no scenario is called 'keep_spit'; did you mean 'keep_spot'"),
        ],
    )
    def test_parts(self, parts: dict[str, Any], message: str):
        with pytest.raises(UsageError, match=message):
            make_scenario(**parts)

    @pytest.mark.parametrize(
        ("parts", "message"),
        [
            ({"wind": "log_sheer"}, "world.wind.*did you mean 'log_shear'"),
            ({"wind": [3]}, "world.wind: expected keys and values, found .3."),
            ({"vehicle": {"type": "pelican", "mas": 2.0}}, "fleets.vehicles.vehicle.mas: .*did you mean 'mass'"),
            ({"vehicle": Quadrotor(mass=-1.0)}, "fleets.vehicles.vehicle.mass: -1.0 is out of range"),  # type: ignore[arg-type]
            ({"vehicle": Quadrotor(mass=np.ones(3))}, "3 numbers in a list; allowed: 2"),  # type: ignore[arg-type]
            ({"controller": "waypoint", "guidance": "velocity"}, "does not fit the controller"),
        ],
    )
    def test_what_they_say(self, parts: dict[str, Any], message: str):
        with pytest.raises(ScenarioError, match=message):
            make_scenario([[0, 0, -10], [9, 0, -10]], **parts)

    def test_components_of_ones_own(self):
        import dataclasses

        @dataclasses.dataclass
        class MyWind:
            speed: float = 3.0

        with pytest.raises(UsageError, match=r"test_making.py: class MyWind is no record; write @qrsim.record"):
            make_scenario([[0, 0, -10]], wind=MyWind())


def test_presets_of_objects_act_as_those_of_a_scenario() -> None:
    """MPU-6000: 0.005 deg/s/sqrt(Hz), one-sided; M8 class: GPS and GLONASS on one frequency."""
    jammer = Jammer(position_ned=np.array([200.0, 0.0, -2.0]), power_w=0.001)  # type: ignore[arg-type]
    sensors = {"imu": Imu(preset="mpu6000"), "gnss": Gnss(preset="m8n", multipath=3.0), "rtk": Gnss(preset="f9p_rtk")}  # type: ignore[arg-type]
    world = {"base_station": {"position_ned": [0, 0, -2]}, "interference": [jammer]}
    controller = {"type": "waypoint", "feed": "truth"}
    made = make_scenario([[0, 0, -10]], sensors=sensors, controller=controller, **world).spec  # type: ignore[arg-type]
    found: Any = made.fleets["vehicles"].sensors
    assert found["imu"].gyroscope_noise == pytest.approx(np.radians(0.005) / np.sqrt(2.0))
    assert (found["gnss"].systems, found["gnss"].frequencies, found["gnss"].cn0_zenith) == ("GR", "single", 48.0)
    assert found["gnss"].multipath == 3.0
    assert found["rtk"].corrections == "rtk"
    assert [(item.kind, item.power_w) for item in made.world.interference] == [("jammer", 0.001)]
    written = {
        "imu": {"type": "imu", "preset": "mpu6000"},
        "gnss": {"type": "gnss", "preset": "m8n", "multipath": 3.0},
        "rtk": {"type": "gnss", "preset": "f9p_rtk"},
    }
    assert (
        found
        == make_scenario([[0, 0, -10]], sensors=written, controller=controller, **world).spec.fleets["vehicles"].sensors
    )  # type: ignore[arg-type]


def test_failsafes_and_what_may_fail_are_parts_of_a_fleet() -> None:
    made = make_scenario(
        [(0.0, 0.0, -10.0)],
        vehicle={"type": "multirotor", "model": "x500"},
        battery="lithium_cells",
        failsafes={"COM_LOW_BAT_ACT": "land", "BAT_CRIT_THR": 0.1},
        injectable={"battery": True},
    )
    (fleet,) = made.world().fleets
    assert (fleet.failsafes.COM_LOW_BAT_ACT, float(fleet.failsafes.BAT_CRIT_THR)) == ("land", pytest.approx(0.1))
    assert fleet.battery_slot is not None
