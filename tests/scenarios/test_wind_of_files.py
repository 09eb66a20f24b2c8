"""Scenarios in the wind of a file: numbers while they are loaded, words for people, and what is refused."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tests.weather_files as files

from qrsim.cli import main
from qrsim.errors import ScenarioError
from qrsim.scenarios.making import make_scenario
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.scenarios.weather import largest_speed, velocity

TABLE = """time,height,speed,direction
2026-05-01T09:00Z,100,8,90
2026-05-01T09:00Z,10,4,180
2026-05-01T11:00Z,10,8,180
2026-05-01T11:00Z,100,12,90
2026-05-01T13:00Z,10,20,180
"""


def load(wind: Any, *overrides: str, **world: Any) -> Scenario:
    content = {
        "name": "x",
        "extends": "hover_ideal",
        "start_time": "2026-05-01T10:00:00Z",
        "duration": 600,
        "site": {"height_amsl": 30.0},
        "world": {"wind": wind, "turbulence": "still", **world},
    }
    return load_scenario(content, overrides, quiet=True)


def table(folder: Path, text: str = TABLE) -> dict[str, str]:
    (folder / "wind.csv").write_text(text)
    return {"type": "profile", "file": str(folder / "wind.csv")}


def test_a_table_of_times(tmp_path: Path) -> None:
    """Half way from 9 to 11 o'clock 4 and 8 m/s are 6; the run needs no row of 13 o'clock, and no file any more."""
    scenario = load(table(tmp_path))
    wind = scenario.spec.world.wind
    assert (wind.heights, wind.times) == ([10.0, 100.0] * 2, [-3600.0] * 2 + [3600.0] * 2)
    north, east = velocity(scenario.spec, np.array([10.0, 100.0]), [0.0])
    np.testing.assert_allclose([north[0], east[0]], [[6.0, 0.0], [0.0, -10.0]], atol=1e-9)
    # 600 s later it is 6 + 4 * 600/7200.
    np.testing.assert_allclose(largest_speed(scenario.spec, np.array([10.0])), 6.3333333)
    (tmp_path / "wind.csv").unlink()
    again = load_scenario({**scenario.spec.model_dump(mode="json"), "name": "y"}, quiet=True)
    assert again.spec.world.wind == wind
    assert len(scenario.to_yaml()) < 2**20


def test_a_file_with_several_cells_in_the_area(tmp_path: Path) -> None:
    """A quarter of a degree of longitude is 0.25 * 111.195 * cos(51.71) = 17.2 km."""
    wind = {"type": "weather", "file": str(files.single_levels(tmp_path / "w.nc"))}
    area = {"type": "box", "x_min": -20e3, "x_max": 20e3, "y_min": -50.0, "y_max": 50.0, "z_min": -90.0, "z_max": 0.0}
    content = {"name": "x", "extends": "hover_ideal", "start_time": "2026-05-01T10:00:00Z", "duration": 600}
    with pytest.warns(
        UserWarning, match=r"w\.nc: its cells are 17 km, and the area is 40 km long; the wind of the site"
    ):
        load_scenario({**content, "world": {"wind": wind, "area": area}})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_scenario({**content, "world": {"wind": wind, "area": {**area, "x_min": 0.0}}})


def test_turbulence_has_the_strength_and_the_bearing_of_the_middle_of_the_run(tmp_path: Path) -> None:
    """At 300 s it is 6 + 4 * 300/7200 m/s at 10 m, and by the logarithm 6.1667 ln(6.096/0.1)/ln(10/0.1) at 20 ft."""
    scenario = load({**table(tmp_path), "roughness": 0.1}, turbulence={"type": "dryden"})
    turbulence = scenario.spec.world.turbulence
    assert turbulence.speed_20ft == pytest.approx(5.50383, abs=1e-4)
    assert turbulence.wind_from_rad == pytest.approx(math.pi)
    given = load(table(tmp_path), turbulence={"type": "dryden", "speed_20ft": 3.0}).spec.world.turbulence
    assert given.speed_20ft == 3.0
    assert given.wind_from_rad == pytest.approx(math.pi)
    steady = {"type": "profile", "heights": [10.0], "speeds": [0.0], "wind_from_deg": [0.0]}
    assert load(steady, turbulence="dryden_field").spec.world.turbulence.speed_20ft == 0.0


def test_a_weather_file_of_a_site_and_a_time(tmp_path: Path) -> None:
    """10 o'clock is an hour after the first; the area's 120 m are between the levels at 80 and 300 m."""
    scenario = load({"type": "weather", "file": str(files.era5(tmp_path / "w.nc"))})
    wind, site = scenario.spec.world.wind, scenario.spec.site
    assert wind.levels == ["1000 hPa", "975 hPa"] * 2
    assert wind.times == [0.0, 0.0, 3600.0, 3600.0]
    north, east = velocity(scenario.spec, np.array([190.0]), [0.0])
    place = (site.latitude_deg, site.longitude_deg)
    assert east[0, 0] == pytest.approx(files.u_of(1.0, 0.5, *place), abs=1e-4)
    assert north[0, 0] == pytest.approx(files.v_of(1.0, 0.5, *place), abs=1e-4)


def test_what_show_prints(tmp_path: Path, capsys: Any) -> None:
    path = files.single_levels(tmp_path / "w.nc")
    (tmp_path / "s.yaml").write_text(
        "{name: s, extends: hover_ideal, start_time: 2026-05-01T09:00:00Z, duration: 60, "
        "site: {latitude_deg: 52.0, longitude_deg: 0.0}, "
        f"world: {{wind: {{type: weather, file: {path}}}, turbulence: dryden}}}}\n"
    )
    assert main(["show", str(tmp_path / "s.yaml"), "--derived"]) == 0
    lines = capsys.readouterr().out.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("wind: "))
    # u 3 and v -2 m/s at 10 m, 4.25 and -2.5 at 100 m: 3.61 and 4.93 m/s from the west-north-west.
    assert lines[first : first + 6] == [
        f"wind: {path}, from 2026-05-01 09:00 to 11:00 UTC; interpolated from 2026-05-01 09:00:00 to 2026-05-01 "
        "10:00:00 UTC; at the start of the run:",
        "    2 m: 2.53 m/s from 304 deg, by the logarithm of height below level 10 m",
        "   10 m: 3.61 m/s from 304 deg, level 10 m",
        "   50 m: 4.19 m/s from 302 deg, between levels 10 m and 100 m",
        "  100 m: 4.93 m/s from 300 deg, level 100 m",
        "  gusts of the model: up to 11.5 m/s, not added; the turbulence reaches 5.5 m/s at 10 m (mean and 3 standard "
        "deviations)",
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("height,speed,direction\n10,3,40\n20,4,400\n", "line 3: direction 400; allowed: 0 to 360"),
        ("height,speed,direction\n10,3,40\n2,60,40\n", "line 3: 60 m/s at 2 m; allowed: 0 to 50; is it km/h?"),
        ("height,speed,direction\n10,3,40\n10,4,40\n", "10 m is there a second time; a wind that changes needs a"),
        ("height,sped,direction\n10,3,40\n", "line 1: no column 'speed'; found height, sped, direction; expected"),
        ("height,speed [km/h],direction\n10,3,40\n", "line 1: column 'speed' is in km/h; expected m/s"),
        ("height,speed,direction\n0.05,3,40\n", "line 2: height 0.05 m; allowed: 0.5 to 30000"),
        ("height,speed,direction\n", "no row under the header"),
        ("time,height,speed,direction\nnoon,10,3,40\n", "line 2: time 'noon'; expected ISO 8601"),
        ("time,height,speed,direction\n2026-05-01,10,3,40\n", "has one time; leave out the column time"),
        (
            "time,height,speed,direction\n2026-05-01T05:00,10,3,40\n2026-05-01T06:00,10,3,40\n",
            "from 2026-05-01 05:00 to 06:00 UTC; the run is from 2026-05-01 10:00 to 10:10 UTC",
        ),
    ],
)
def test_a_wrong_table(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ScenarioError) as error:
        load(table(tmp_path, text))
    assert words in str(error.value)
    assert "world.wind: " in str(error.value)


@pytest.mark.parametrize(
    ("wind", "words"),
    [
        ({"type": "profile"}, "world.wind: heights: missing; give heights, speeds and wind_from_deg, or a file"),
        ({"type": "profile", "heights": [10], "speeds": [3]}, "world.wind: wind_from_rad: 0 numbers; heights has 1"),
        ({"type": "profile", "file": "w.csv", "heights": [10.0]}, "world.wind: heights: is given along with a file"),
        ({"type": "profile", "file": "missing.csv"}, "missing.csv: cannot be read: No such file"),
        ({"type": "weather", "file": "missing.nc"}, "missing.nc: cannot be read: No such file"),
        ({"type": "weather"}, "world.wind.file: missing"),
        ({"type": "weather", "file": "w.nc", "abov": "sea"}, "did you mean 'above'"),
        ({"type": "profile", "heights": ["a"]}, "world.wind.heights.0: 'a' is not a number"),
        ({"type": "weathr", "file": "w.nc"}, "did you mean 'weather'"),
    ],
)
def test_a_wrong_wind(wind: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError) as error:
        load(wind)
    assert words in str(error.value)


def test_a_file_of_the_other_type(tmp_path: Path) -> None:
    (tmp_path / "day.grib2").write_bytes(b"GRIB\0\0\0\2")
    with pytest.raises(ScenarioError, match=r"day\.grib2: is GRIB; a file of a weather model is of type weather"):
        load({"type": "profile", "file": str(tmp_path / "day.grib2")})


def test_speeds_in_knots_and_heights_in_any_order(tmp_path: Path) -> None:
    """10 knots are 5.144444 m/s; a table without times holds for any run."""
    wind = load(table(tmp_path, "height [m];speed_kn;direction [deg]\n50;20;90\n10;10;0\n")).spec.world.wind
    assert wind.heights == [10.0, 50.0]
    assert wind.speeds == pytest.approx([5.144444, 10.288889])
    assert wind.times == []


def test_what_knows_the_mean_wind_takes_a_profile(tmp_path: Path) -> None:
    """A plume is carried by it, sensors 'noisy' bring gusts of its strength, and its change in flight is refused."""
    strong = {"type": "profile", "heights": [10.0], "speeds": [12.0], "wind_from_deg": [0.0]}
    load(strong, plume={"type": "dispersion"})
    calm = {**strong, "speeds": [0.0]}
    with pytest.raises(ScenarioError, match=r"needs a wind with a speed_20ft above 0; world.wind is of 0 m/s"):
        load(calm, plume={"type": "dispersion"})
    noisy = make_scenario([[0, 0, -10]], wind=strong, sensors="noisy").spec.world.turbulence
    assert (noisy.type, noisy.speed_20ft > 5.0) == ("dryden_field", True)
    with pytest.raises(ScenarioError, match="only that of type log_shear"):
        load(strong, events=[{"at": 1.0, "wind": {"speed_20ft": 3.0}}])


def test_a_run_in_more_rows_than_a_scenario_holds(tmp_path: Path) -> None:
    """Two rows a second for 10 000 s; those of ten minutes are few enough."""
    lines = [f"2026-05-01T{9 + i // 7200:02}:{i // 120 % 60:02}:{i / 2 % 60:04.1f}Z,10,4,180" for i in range(20_000)]
    wind = table(tmp_path, "\n".join(["time,height,speed,direction", *lines]))
    assert len(load(wind).spec.world.wind.heights) == 1201
    with pytest.raises(ScenarioError, match="10001 rows in the run and the area; allowed: 10000"):
        load(wind, "start_time=2026-05-01T09:00:00Z", "duration=5000")
