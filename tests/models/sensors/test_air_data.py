"""Pressure altimeter and airspeed: the standard atmosphere's published numbers, and each error against its equation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy
from evidence import air_data as study

from qrsim import Simulation, make_scenario
from qrsim.core.noise import Drawn
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import ScenarioError
from qrsim.links.reference.readout import Readout
from qrsim.models.atmosphere import standard
from qrsim.models.scene.ground import FlatGround
from qrsim.models.sensors.air_presets import AIRSPEEDS, ALTIMETERS
from qrsim.models.sensors.airspeed import Airspeed, IdealAirspeed
from qrsim.models.sensors.pressure import PressureAltimeter
from qrsim.models.vehicles.contracts import Load

TRUTH = {"type": "waypoint", "feed": "truth"}
PORTS = dict.fromkeys(("port_forward", "port_backward", "port_right", "port_left", "port_vertical"), 0.0)
# Nothing but what a test adds.
CLEAN = {**PORTS, **dict.fromkeys(("noise_std", "offset_std", "drift_std", "rotor_wash", "ground_effect"), 0.0)}
STILL: dict[str, Any] = {"velocity": (0.0, 0.0, 0.0), "wind": (0.0, 0.0, 0.0), "angles": (0.0, 0.0, 0.0)}


def vector(*values: float) -> Any:
    return Vec3(*(np.array([value], np.float32) for value in values))  # type: ignore[arg-type]


def scene(height: float, thrust: float = 1.0, **given: Any) -> dict[str, Any]:
    """What a sensor sees of a vehicle over flat ground; ``velocity`` is in body axes, ``angles`` roll, pitch, yaw."""
    state = {**STILL, **given}
    roll, pitch, yaw = state["angles"]
    ned = scipy.spatial.transform.Rotation.from_euler("ZYX", [yaw, pitch, roll]).apply(state["velocity"])
    return {
        "position_ned": vector(0.0, 0.0, -height),
        "velocity_ned": vector(*ned),
        "attitude": Euler(*(np.array([angle], np.float32) for angle in (roll, pitch, yaw))),  # type: ignore[arg-type]
        "velocity_body": vector(*state["velocity"]),
        "wind_ned": vector(*state["wind"]),
        "load": Load(np.array([thrust], np.float32), np.array([1.0], np.float32)),
        "ground": FlatGround(),  # type: ignore[arg-type]
    }


def drawn(*values: float) -> Any:
    return Drawn(tuple(np.array([value], np.float32) for value in values))  # type: ignore[arg-type]


def at(sensor: Any, where: dict[str, Any], *normals: float) -> Any:
    """The first reading, as numbers."""
    found = sensor.init(drawn(*(normals or (0.0,) * 3)), **{name: where[name] for name in sensor.reads})[1]
    return type(found)(*(float(np.asarray(getattr(found, name))[0]) for name in found.__dataclass_fields__))


def altimeter(**given: Any) -> Any:
    return cast(PressureAltimeter(**{**CLEAN, **given}), np.float32)


class TestStandardAtmosphere:
    # Geopotential height [m], temperature [K], pressure [Pa], density [kg/m^3]: U.S. Standard Atmosphere 1976, table I.
    PUBLISHED = (
        (0.0, 288.150, 101325.0, 1.2250),
        (1000.0, 281.650, 89874.6, 1.1116),
        (2000.0, 275.150, 79495.2, 1.0065),
        (5000.0, 255.650, 54019.9, 0.73612),
        (11000.0, 216.650, 22632.1, 0.36392),
    )

    @pytest.mark.parametrize("row", PUBLISHED)
    def test_published_values(self, row: tuple[float, ...]) -> None:
        height, warmth, pressure, density = row
        assert standard.temperature(height) == pytest.approx(warmth, abs=1e-9)
        assert standard.pressure(height) == pytest.approx(pressure, abs=0.06)
        assert standard.density(height) == pytest.approx(density, rel=6e-5)
        # The same from a site at sea level, in single precision.
        above = standard.air_above(np.array([height], np.float32), 288.15, 101325.0)  # type: ignore[arg-type]
        assert float(above.pressure[0]) == pytest.approx(pressure, rel=5e-6)
        assert float(above.density[0]) == pytest.approx(density, rel=6e-5)
        assert float(above.temperature[0]) == pytest.approx(warmth, rel=1e-6)


class TestAltimeter:
    def test_a_clean_one_says_height_and_air(self) -> None:
        """From a site at 900 m, 100 m up: the air of 1000 m."""
        sensor = altimeter(site_temperature=standard.temperature(900.0), site_pressure=standard.pressure(900.0))
        found = at(sensor, scene(100.0, velocity=(3.0, 0.0, -2.0)))
        assert found.height == pytest.approx(100.0, abs=1e-3)
        assert found.height_rate == pytest.approx(2.0, abs=1e-5)
        assert found.pressure == pytest.approx(89874.6, abs=0.3)
        assert found.temperature == pytest.approx(281.65, abs=1e-3)

    def test_noise_is_pressure(self) -> None:
        """1.2 Pa at sea level, where a metre is 12.01 Pa: 0.1 m lower."""
        found = at(altimeter(noise_std=1.2), scene(0.0), 1.0, 0.0, 0.0)
        assert found.height == pytest.approx(-1.2 / 12.013, abs=1e-4)
        assert found.pressure == pytest.approx(101326.2, abs=0.05)

    def test_the_offset_is_zeroed_in_the_height(self) -> None:
        for zeroed, height in ((True, 0.0), (False, -100.0 / 12.013)):
            found = at(altimeter(offset_std=100.0, zeroed=zeroed), scene(0.0), 0.0, 0.0, 1.0)
            assert found.height == pytest.approx(height, rel=1e-3, abs=1e-3)
            assert found.pressure == pytest.approx(101425.0, abs=0.6)

    def test_a_metre_is_more_on_a_cold_day(self) -> None:
        """28.8 K colder than standard at sea level: 10 % thicker air, so a hundred metres look like 111."""
        found = at(altimeter(warmer=-28.815), scene(100.0))
        assert found.height == pytest.approx(100.0 / 0.9, abs=0.01)
        assert found.temperature == pytest.approx(288.15 - 0.65 - 28.815, abs=1e-3)

    @pytest.mark.parametrize(
        ("port", "velocity", "factor"),
        [
            ("port_forward", (10.0, 0.0, 0.0), 1.0),
            ("port_backward", (-10.0, 0.0, 0.0), 1.0),
            ("port_right", (0.0, 10.0, 0.0), 1.0),
            ("port_left", (0.0, -10.0, 0.0), 1.0),
            ("port_vertical", (0.0, 0.0, 10.0), 1.0),
            ("port_vertical", (0.0, 0.0, -10.0), -1.0),
            ("port_forward", (-10.0, 5.0, 3.0), 0.0),
            ("port_right", (9.0, -10.0, 3.0), 0.0),
        ],
    )
    def test_dynamic_pressure_at_the_port(self, port: str, velocity: tuple[float, ...], factor: float) -> None:
        """k rho v^2/2 with k = 0.2 at 10 m/s: 12.25 Pa, 1.02 m at sea level."""
        found = at(altimeter(**{port: 0.2}), scene(0.0, velocity=velocity))
        assert found.pressure - 101325.0 == pytest.approx(12.25 * factor, abs=0.02)
        assert found.height == pytest.approx(-12.25 / 12.013 * factor, abs=2e-3)

    def test_it_is_the_air_that_counts(self) -> None:
        """A wind from the east on a vehicle that stands and looks north comes from its right."""
        found = at(altimeter(port_right=0.2, port_left=-0.5), scene(0.0, wind=(0.0, -10.0, 0.0)))
        assert found.pressure - 101325.0 == pytest.approx(12.25, abs=0.02)
        # Who flies with it feels nothing; who looks east has it from ahead.
        assert at(altimeter(port_left=-0.5), scene(0.0, wind=(10.0, 0.0, 0.0), velocity=(10.0, 0.0, 0.0))).height == 0.0
        turned = at(altimeter(port_forward=0.2), scene(0.0, wind=(0.0, -10.0, 0.0), angles=(0.0, 0.0, math.pi / 2)))
        assert turned.pressure - 101325.0 == pytest.approx(12.25, abs=0.02)

    def test_rotors(self) -> None:
        """By thrust; under them on the ground, a quarter of it half a diameter above, none from one diameter on."""
        for thrust in (0.0, 1.0, 1.5):
            found = at(altimeter(rotor_wash=-6.0), scene(5.0, thrust))
            assert found.height == pytest.approx(5.0 + 0.4995 * thrust, abs=2e-3)
        bump = altimeter(ground_effect=12.0, rotor_diameter=0.4)
        for height, share in ((0.0, 1.0), (0.2, 0.25), (0.4, 0.0), (3.0, 0.0)):
            for thrust in (1.0, 0.5):
                found = at(bump, scene(height, thrust))
                assert height - found.height == pytest.approx(12.0 / 12.013 * share * thrust, abs=2e-3)
        # Of a vehicle that says how large its rotors are, by itself; 0.25 m where it does not.
        found = at(altimeter(ground_effect=12.0), scene(0.125))
        assert 0.125 - found.height == pytest.approx(0.25 * 12.0 / 12.013, abs=2e-3)
        found = at(altimeter(ground_effect=12.0, vehicle_rotor=0.5), scene(0.25))
        assert 0.25 - found.height == pytest.approx(0.25 * 12.0 / 12.013, abs=2e-3)

    def test_weather_drifts_as_it_does_for_the_published_barometer(self) -> None:
        sensor = altimeter(drift_std=0.26, drift_time_constant=300.0, period=60.0)
        where = scene(0.0)
        state, reading = sensor.init(drawn(0.0, 2.0, 0.0), **where)
        assert float(reading.height[0]) == pytest.approx(0.52, abs=1e-4)
        state, reading = sensor.step(state, drawn(0.0, 1.0), **where)
        decay = math.exp(-0.2)
        assert float(reading.height[0]) == pytest.approx(0.52 * decay + 0.26 * math.sqrt(1 - decay**2), abs=1e-4)

    def test_the_rate_is_low_passed(self) -> None:
        """From 0 to a climb of 2 m/s: 1 - (1 - T/(T + tau))^n of it after n periods."""
        sensor = altimeter(rate_time_constant=0.5, period=0.1)
        state, _ = sensor.init(drawn(0.0, 0.0, 0.0), **scene(10.0))
        for n in range(1, 8):
            state, reading = sensor.step(state, drawn(0.0, 0.0), **scene(10.0 + 0.2 * n))
            assert float(reading.height_rate[0]) == pytest.approx(2.0 * (1.0 - (5.0 / 6.0) ** n), abs=3e-3)

    def test_placed_anew(self) -> None:
        """The chip's offset and the weather stay; the next rate is that of a whole period."""
        sensor = altimeter(drift_std=1.0, drift_time_constant=1e9, period=0.1, rate_time_constant=0.0)
        state, _ = sensor.init(drawn(0.0, 3.0, 0.0), **scene(10.0))
        up = {"velocity": (0.0, 0.0, -2.0)}
        state, reading = sensor.restart(state, drawn(0.0, 0.0, 0.0), np.array([0.04], np.float32), **scene(50.0, **up))
        assert float(reading.height[0]) == pytest.approx(53.0, abs=1e-3)
        _, reading = sensor.step(state, drawn(0.0, 0.0), **scene(50.12, **up))
        assert float(reading.height_rate[0]) == pytest.approx(2.0, abs=2e-2)


class TestAirspeed:
    QUIET = {"noise_std": 0.0, "offset_std": 0.0, "scale": 0.0, "range": 0.0, "resolution": 0.0}  # noqa: RUF012

    def pitot(self, **given: Any) -> Any:
        return cast(Airspeed(**{**self.QUIET, **given}), np.float32)

    def test_indicated_and_true(self) -> None:
        """At 2000 m 20 m/s are 201.3 Pa, which 18.13 m/s would have at sea level."""
        site = {"site_temperature": standard.temperature(1900.0), "site_pressure": standard.pressure(1900.0)}
        where = scene(100.0, velocity=(20.0, 6.0, -3.0))
        found = at(self.pitot(**site), where)
        assert found.differential_pressure == pytest.approx(0.5 * 1.00649 * 400.0, rel=1e-4)
        assert found.indicated_airspeed == pytest.approx(18.128, abs=2e-3)
        assert found.true_airspeed == pytest.approx(20.0, abs=2e-3)
        ideal = at(cast(IdealAirspeed(**site), np.float32), where)
        assert ideal.indicated_airspeed == pytest.approx(18.128, abs=2e-3)
        assert ideal.true_airspeed == pytest.approx(20.0, abs=1e-4)

    def test_it_is_the_air_from_ahead(self) -> None:
        """Over ground 8 m/s to the east, against 4 m/s of wind, 0.3 rad of pitch: 12 cos 0.3."""
        turn = scipy.spatial.transform.Rotation.from_euler("ZYX", [math.pi / 2, 0.3, 0.0])
        velocity = turn.inv().apply([0.0, 8.0, 0.0])
        where = scene(0.0, velocity=tuple(velocity), wind=(0.0, -4.0, 0.0), angles=(0.0, 0.3, math.pi / 2))
        assert at(self.pitot(), where).true_airspeed == pytest.approx(12.0 * math.cos(0.3), abs=1e-3)

    def test_sign_and_slow_air_are_lost(self) -> None:
        behind = at(self.pitot(), scene(0.0, velocity=(-20.0, 0.0, 0.0)))
        assert behind.differential_pressure == pytest.approx(-0.3 * 245.0, rel=1e-4)
        assert behind.indicated_airspeed == pytest.approx(20.0 * math.sqrt(0.3), abs=1e-3)
        assert at(self.pitot(), scene(0.0, velocity=(5.1, 0.0, 0.0))).indicated_airspeed == pytest.approx(5.1, abs=1e-3)
        slow = at(self.pitot(), scene(0.0, velocity=(4.9, 0.0, 0.0)))
        assert slow.differential_pressure == pytest.approx(0.6125 * 4.9**2, rel=1e-4)
        assert math.isnan(slow.indicated_airspeed)
        assert math.isnan(slow.true_airspeed)
        assert slow.reason(0) == "slower than a pitot tube can measure"
        always = at(self.pitot(speed_min=0.0), scene(0.0))
        assert always.indicated_airspeed == 0.0

    def test_noise_offset_scale_range_and_steps(self) -> None:
        """At 10 m/s 61.25 Pa; 10 % more, 2 Pa offset, 0.5 Pa noise; at rest noise looks like a speed."""
        sensor = self.pitot(noise_std=0.5, offset_std=2.0, scale=0.1)
        where = scene(0.0, velocity=(10.0, 0.0, 0.0))
        found = at(sensor, where, -1.0, 1.0, 1.0)
        assert found.differential_pressure == pytest.approx(61.25 * 1.1 + 2.0 - 0.5, rel=1e-5)
        rest = at(replace(sensor, speed_min=np.float32(0.0)), scene(0.0), 1.0, -1.0, 0.0)
        assert rest.differential_pressure == pytest.approx(-1.5, abs=1e-5)
        assert rest.indicated_airspeed == pytest.approx(math.sqrt(3.0 / 1.225), abs=1e-4)
        stepped = self.pitot(range=60.3, resolution=0.25)
        assert at(stepped, where).differential_pressure == pytest.approx(60.25, abs=1e-5)
        assert at(replace(stepped, range=0.0), where).differential_pressure == pytest.approx(61.25, abs=1e-5)

    def test_placed_anew_it_is_not_zeroed_again(self) -> None:
        sensor = self.pitot(offset_std=2.0)
        where = {name: scene(0.0)[name] for name in sensor.reads}
        state, _ = sensor.init(drawn(0.0, 1.0, 0.0), **where)
        _, reading = sensor.restart(state, drawn(0.0, 0.0, 0.0), np.zeros(1, np.float32), **where)
        assert float(reading.differential_pressure[0]) == pytest.approx(2.0)


# Noise and offset [Pa]; docs/howto/sensors_heading_and_height.md.
ALTIMETER_SHEETS = {"ms5611": (1.2, 50.0), "bmp280": (1.3, 100.0), "bmp390": (0.3, 50.0)}
# Noise, offset [Pa], scale, range and step [Pa].
AIRSPEED_SHEETS = {"ms4525do": (2.0, 3.0, 0.0025, 6895.0, 1.052), "sdp33": (0.2, 0.2, 0.03, 1500.0, 0.05)}


def test_presets_are_those_of_the_data_sheets() -> None:
    found = {name: (row["noise_std"], row["offset_std"]) for name, row in ALTIMETERS.items()}
    assert found == ALTIMETER_SHEETS
    assert set(AIRSPEEDS) == set(AIRSPEED_SHEETS)
    for name, row in AIRSPEEDS.items():
        given = tuple(row[key] for key in ("noise_std", "offset_std", "scale", "range", "resolution"))
        assert given == pytest.approx(AIRSPEED_SHEETS[name], rel=1e-3)


class TestInAWorld:
    def test_site_and_vehicle_are_those_of_the_scenario(self) -> None:
        sensors = {
            "baro": {"type": "pressure_altimeter"},
            "pitot": {"type": "airspeed"},
            "true": {"type": "ideal_airspeed"},
        }
        (fleet,) = (
            make_scenario(
                [[0.0, 0.0, -10.0]],
                site={"height": 1000.0},
                vehicle={"type": "multirotor"},
                sensors=sensors,
                controller={"type": "cascade", "feed": "truth"},
            )
            .world()
            .fleets
        )
        for sensor in fleet.sensors:
            assert float(sensor.site_pressure) == pytest.approx(89874.6, abs=0.1)  # type: ignore[attr-defined]
            assert float(sensor.site_temperature) == pytest.approx(281.65, abs=1e-3)  # type: ignore[attr-defined]
        radius = float(np.ravel(fleet.vehicle.rotor_radius)[0])  # type: ignore[attr-defined]
        assert float(fleet.sensors[0].vehicle_rotor) == pytest.approx(2.0 * radius)  # type: ignore[attr-defined]

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"type": "pressure_altimeter", "preset": "ms561"}, "did you mean 'ms5611'"),
            ({"type": "pressure_altimeter", "port_forwards": 1.0}, "did you mean 'port_forward'"),
            ({"type": "airspeed", "preset": "sdp3"}, "did you mean 'sdp33'"),
            ({"type": "airspeed", "reverse": 2.0}, r"reverse: 2\.0 is out of range"),
        ],
    )
    def test_errors(self, given: dict[str, Any], message: str) -> None:
        with pytest.raises(ScenarioError, match=message):
            make_scenario([[0.0, 0.0, -10.0]], sensors={"tested": given}, controller=TRUTH)

    @pytest.mark.long
    def test_the_study(self) -> None:
        """0.1 m of noise; half a metre by rotors in hover, more by those that lean against the wind; a drift."""
        found = study.run(full=False)
        height = found["height"]
        assert height["noise"]["std"] == pytest.approx(0.1, rel=0.15)
        assert 0.02 < height["weather"]["std"] < 0.8
        assert height["rotors"]["mean"] == pytest.approx(0.8, abs=0.2)
        assert 0.1 < height["wind"]["mean"] < 1.0
        for row in found["airspeed"].values():
            assert row["said"] > 0.5
            assert 0.0 < row["rms"] < 1.5

    @pytest.mark.long
    @pytest.mark.usefixtures("optimised")
    def test_a_patrol_flies_on_it_and_both_compilers_alike(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Fed with measurements, whose height is now that of the altimeter; with a fault, delay and mounting."""
        import warnings

        flown = []
        sensors = {
            "gnss": {"type": "gnss_receiver"},
            "attitude": {"type": "attitude_estimator"},
            "baro": {"type": "pressure_altimeter", "delay": 2, "mount_position_body": [0.1, 0.0, 0.0]},
            "pitot": {"type": "airspeed"},
        }
        faults = [{"sensor": "pitot", "kind": "biased", "field": "differential_pressure", "bias": 100.0, "start": 3.0}]
        for compiler in ("llvm", "xla"):
            monkeypatch.setenv("QRSIM_COMPILER", compiler)
            world = make_scenario(
                [[0.0, 0.0, -20.0]],
                sensors=sensors,
                faults=faults,
                controller={"type": "waypoint", "feed": "measurements"},
                wind={"type": "log_shear", "speed_20ft": 3.0, "wind_from_deg": 90.0},
            ).world()
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                simulation = Simulation(world, seed=3)
                simulation.reset()
                reading = simulation.step(ticks=250)
            assert simulation.compiled_by[0] == compiler
            assert simulation.valid.all()
            assert abs(simulation.truth.position_ned[0, 2] + 20.0) < 4.0
            # What clients of the reference protocol are sent as barometric height and its rate.
            sent = Readout(simulation).message().eX[0].value
            assert [sent[16], sent[19]] == pytest.approx([reading.baro.height[0], reading.baro.height_rate[0]])
            assert reading.pitot.reasons == ["slower than a pitot tube can measure"]
            flown.append((reading.baro.height, reading.baro.pressure, reading.pitot.differential_pressure))
            assert abs(reading.pitot.differential_pressure[0] - 100.0) < 20.0
        for a, b, tolerance in zip(*flown, (0.02, 0.3, 0.1), strict=True):
            np.testing.assert_allclose(a, b, atol=tolerance)
