"""Orbits of an SP3 file under receivers of type gnss: which systems, what is missing, and the fixes."""

from __future__ import annotations

import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.models.gnss.sp3_writing import four_systems

import qrsim
from qrsim.errors import ScenarioError
from qrsim.scenarios.scenario import Scenario, load_scenario

BASE = {"position_ned": [0.0, 0.0, -2.0]}


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    """Return paths of a file of four systems (SP3-d), and of one of GPS and GLONASS (SP3-c)."""
    found = {}
    for letters, version in (("GERC", "d"), ("GR", "c")):
        path = tmp_path / f"{letters}.sp3"
        path.write_text(four_systems(letters, version), encoding="latin-1")
        found[letters] = str(path)
    return found


def scenario(sensors: dict[str, Any], orbits: dict[str, Any], **more: Any) -> Scenario:
    """Return a scenario of two vehicles; the file's epochs are of 2010-08-31, 15:00 to 19:45 GPS time."""
    return load_scenario(
        {
            "name": "x",
            "duration": 60.0,
            "start_time": "2010-08-31T16:30:00Z",
            "world": {"sky": {"orbits": orbits}, "base_station": BASE},
            "fleets": {
                "a": {
                    "sensors": sensors,
                    "controller": {"type": "cascade", "feed": "truth"},
                    "vehicles": [{"position_ned": [30.0 * i, 0.0, -20.0]} for i in range(2)],
                }
            },
            **more,
        }
    )


def sp3(path: str, **more: Any) -> dict[str, Any]:
    return {"type": "sp3", "file": path, **more}


def gnss(**given: Any) -> dict[str, Any]:
    return {"gnss": {"type": "gnss", **given}}


def systems(made: Scenario) -> dict[str, int]:
    """Return how many satellites of each system a world has; the upper byte of a number is the letter."""
    sky: Any = made.world().sky
    return Counter(chr(int(number) >> 8) for number in np.asarray(sky.ids))


class TestSystems:
    def test_without_a_word_they_are_those_of_the_receivers(self, files: dict[str, str]) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert systems(scenario(gnss(), sp3(files["GERC"]))) == {"G": 24, "E": 24, "R": 24, "C": 24}
            assert systems(scenario(gnss(preset="m8n"), sp3(files["GERC"]))) == {"G": 24, "R": 24}
            assert systems(scenario(gnss(systems="E"), sp3(files["GERC"]))) == {"E": 24}
            # The published receiver keeps GPS, also beside others.
            old = {"gnss": {"type": "gnss_receiver"}}
            assert systems(scenario(old, sp3(files["GERC"]))) == {"G": 24}
            both = {"old": {"type": "gnss_receiver"}, **gnss(systems="E")}
            assert systems(scenario(both, sp3(files["GERC"]))) == {"G": 24, "E": 24}

    def test_those_that_are_asked_for(self, files: dict[str, str]) -> None:
        assert systems(scenario(gnss(), sp3(files["GERC"], systems="GC"))) == {"G": 24, "C": 24}

    def test_a_receiver_is_told_what_the_file_lacks(self, files: dict[str, str]) -> None:
        made = scenario(gnss(preset="f9p_rtk"), sp3(files["GR"]))
        with pytest.warns(UserWarning, match="no satellite of") as caught:
            assert systems(made) == {"G": 24, "R": 24}
        (message,) = [str(warning.message) for warning in caught]
        assert message == (
            f"fleets.a.sensors.gnss.systems: 'GERC', but {files['GR']} has no satellite of 'EC'; "
            "it has G (GPS): 24, R (GLONASS): 24"
        )

    @pytest.mark.parametrize(
        ("asked", "sensor", "more", "expected"),
        [
            ({"systems": "GE"}, {}, {}, "no satellite of systems 'E' of 'GE'; the file has G (GPS): 24, R (GLONASS): "),
            ({"systems": "C"}, {}, {}, "no satellite of systems 'C'; the file has G (GPS): 24, R (GLONASS): 24"),
            ({"systems": "X"}, {}, {}, "systems: 'X' does not consist of letters of satellite systems: G (GPS)"),
            (
                {},
                {"systems": "EC"},
                {},
                "fleets.a.sensors.gnss.systems: 'EC', but world.sky.orbits has satellites of G",
            ),
            ({}, {}, {"start_time": "2024-01-01T00:00:00Z"}, "allowed: 2010-08-31 14:59:45 to 2010-08-31 19:44:45 UTC"),
            ({}, {}, {"duration": 86400.0}, "86400 s, is outside the time of world.sky.orbits; allowed: 2010-08-31"),
        ],
    )
    def test_what_is_wrong_is_said_in_one_line(
        self, files: dict[str, str], asked: dict[str, Any], sensor: dict[str, Any], more: dict[str, Any], expected: str
    ) -> None:
        with pytest.raises(ScenarioError) as caught:
            scenario(gnss(**sensor), sp3(files["GR"], **asked), **more)
        (problem,) = caught.value.problems
        assert expected in problem
        assert "\n" not in problem


@pytest.mark.long
@pytest.mark.parametrize(("preset", "fix_type"), [("f9p_single", 3), ("f9p_rtk", 6)])
def test_fixes_are_those_of_the_orbits_that_the_file_was_made_of(
    files: dict[str, str], preset: str, fix_type: int
) -> None:
    found = []
    for orbits in (sp3(files["GERC"]), {"type": "nominal_constellations"}):
        simulation = qrsim.Simulation(scenario(gnss(preset=preset, first_fix="fixed"), orbits).world(), seed=1)
        simulation.reset()
        for _ in range(500):
            reading = simulation.step()
        assert reading.gnss.fix_type.tolist() == [fix_type] * 2
        found.append(reading.gnss)
    exact, nominal = found
    assert exact.satellites.tolist() == nominal.satellites.tolist()
    # The file's millimetres are rounded, its orbits interpolated.
    np.testing.assert_allclose(exact.hdop, nominal.hdop, rtol=1e-4)
    np.testing.assert_allclose(exact.horizontal_accuracy, nominal.horizontal_accuracy, rtol=1e-4)
