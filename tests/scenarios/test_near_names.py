"""Names that people know from elsewhere, and places and folders that are taken for others, lead to the right one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from qrsim.cli import main
from qrsim.errors import ScenarioError, did_you_mean, nearest
from qrsim.scenarios.scenario import load_scenario


def problem_of(fleet: dict[str, Any] | None = None, **parts: Any) -> str:
    fleet = {"vehicles": [{"position_ned": [0, 0, -9]}], "sensors": "ideal", **(fleet or {})}
    with pytest.raises(ScenarioError) as caught:
        load_scenario({"name": "x", **parts, "fleets": {"a": fleet}})
    return "\n".join(caught.value.problems)


@pytest.mark.parametrize(
    ("fleet", "parts", "expected"),
    [
        (
            {},
            {"world": {"wind": {"type": "log_shear", "speed": 4.0, "wind_from": 90}}},
            "did you mean 'wind_from_deg'?",
        ),
        ({}, {"world": {"wind": {"type": "log_shear", "speed_20ft": 4.0, "direction": 9}}}, "mean 'wind_from_deg'?"),
        ({"sensors": {"gps": {"type": "gps"}}}, {}, "no such type 'gps'; did you mean 'gnss'?"),
        ({"battery": {"type": "lipo"}}, {}, "no such type 'lipo'; did you mean 'lithium_cells'?"),
        ({"battery": "LiPo"}, {}, "no such type 'LiPo'; did you mean 'lithium_cells'?"),
        ({}, {"site": {"lat": 51.0}}, "site.lat: no such parameter of 'site'; did you mean 'latitude_deg'?"),
        ({}, {"site": {"lon": 0.0}}, "site.lon: no such parameter of 'site'; did you mean 'longitude_deg'?"),
        ({}, {"site": {"alt": 0.0}}, "site.alt: no such parameter of 'site'; did you mean 'height'?"),
        ({"vehicle": {"type": "x500"}}, {}, "no such type 'x500'; write {type: multirotor, model: x500}"),
        ({"vehicle": "x500"}, {}, "no such type 'x500'; write {type: multirotor, model: x500}"),
        ({"vehicle": {"model": "x500"}}, {}, "parameter of 'pelican'; write {type: multirotor, model: x500}"),
        # Canberra.
        (
            {},
            {"site": {"latitude_deg": 149.1, "longitude_deg": -35.3}},
            "149.1 is out of range; allowed: -90 to 90; latitude and longitude seem to be swapped",
        ),
    ],
)
def test_a_name_from_elsewhere(fleet: dict[str, Any], parts: dict[str, Any], expected: str) -> None:
    assert expected in problem_of(fleet, **parts)


def test_a_place_that_is_near_when_it_is_swapped() -> None:
    place = {"latitude_deg": 8.0, "longitude_deg": 47.0, "height": 9.0}
    fleet = {"vehicles": [{"position_geodetic": place}]}
    site = {"latitude_deg": 47.0, "longitude_deg": 8.01}
    assert problem_of(fleet, site=site).endswith("; with latitude and longitude swapped it is 0.761 km away")
    site = {"latitude_deg": 40.0, "longitude_deg": 8.0}
    assert problem_of(fleet, site=site).endswith("(see site.latitude_deg and site.longitude_deg)")


def test_an_angle_is_one_in_degrees_unless_radians_are_named() -> None:
    known = ["wind_from_rad", "wind_from_deg", "speed"]
    assert nearest("wind_from", known) == "wind_from_deg"
    assert nearest("wind_form_rad", known) == "wind_from_rad"
    assert did_you_mean("wind_from", ["wind_from_rad"]) == "; did you mean 'wind_from_rad'?"


@pytest.mark.parametrize("command", ["run", "check", "show"])
def test_a_run_folder_in_place_of_a_scenario(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "first"
    folder.mkdir()
    (folder / "run.json").write_text("{}")
    assert main([command, str(folder)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{folder} is a run folder and no scenario: 'qrsim view {folder}' shows the flight, and 'qrsim run" in line
    assert f"{folder}/scenario.yaml' flies its scenario again" in line
