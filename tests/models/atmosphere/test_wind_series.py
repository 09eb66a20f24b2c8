"""Wind from a file against NumPy's interpolation, what is wrong with files, and the veering profile."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast
from qrsim.errors import UsageError
from qrsim.models.atmosphere.wind import LogShear
from qrsim.models.atmosphere.wind_series import VeeringShear, WindFile, WindSeries

Array = np.ndarray[Any, Any]


def write(folder: Path, times: Array, air: Array) -> WindFile:
    """A file of (K,) times and (K, 3) velocities, every digit kept."""
    path = folder / "wind.csv"
    rows = [",".join(map(repr, map(float, (time, *wind)))) for time, wind in zip(times, air, strict=True)]
    path.write_text("\n".join(["time,north,east,down", *rows]) + "\n", encoding="utf-8")
    return WindFile(str(path), max_gap=1e6)


def test_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    path = tmp_path / "wind.csv"
    path.write_text("time;north;east;down;station\n0,0;1,5;-2;,25;Köln\n10;2,5;1e1;0,0;A,1\n", encoding="utf-8-sig")
    found = look_up(WindFile(str(path), max_gap=60.0).at(10.0), np.array([0.0, 5.0]), "float64")
    assert found.tolist() == [[1.5, -2.0, 0.25], [2.0, 4.0, 0.125]]
    path.write_text('time,north,east,down\n0,1,2,3\n10,"1,5",2,3\n')
    with pytest.raises(UsageError, match="line 3: column 'north': '1,5' is not a finite number"):
        WindFile(str(path), max_gap=60.0).at(10.0)


@jax.jit
def evaluate(series: WindSeries, seconds: Any, fraction: Any) -> Any:
    """Velocities (k, 3), a time (k,) after the other, as a tick asks for them."""
    height = jnp.zeros(1, fraction.dtype)
    return jax.vmap(lambda s, f: series.velocity_ned(height, s, f).stack()[0])(seconds, fraction)


def look_up(series: WindSeries, times: Array, precision: str) -> Array:
    """Velocities (k, 3) at times (k,)."""
    with jax.enable_x64(precision == "float64"):
        whole = np.floor(times)
        time = jnp.asarray(whole, jnp.int32), jnp.asarray(times - whole, precision)
        return np.asarray(evaluate(cast(series, precision), *time), np.float64)


# Between two rows 0.05 s apart the wind may change by 20 m/s, and a float32 fraction of a second is 3e-8 off.
@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-7), ("float32", 5e-5)])
@pytest.mark.parametrize("rows", [2, 3, 1001])
def test_linear_interpolation(tmp_path: Path, rows: int, precision: str, tolerance: float) -> None:
    """Uneven times, several rows in one second, times before the start; also days into a run."""
    generator = np.random.default_rng(rows)
    for offset in (-3.3, 0.0, 400_000.0):
        times = offset + np.cumsum(generator.uniform(0.05, 2.0, rows))
        # The series must cover the start of the run, whatever is asked of it here.
        times[0], times[-1] = min(times[0], 0.0), max(times[-1], 1.0)
        air = generator.normal(0.0, 5.0, (rows, 3))
        asked = np.concatenate([generator.uniform(times[1] - 1.0, times[-1], 300), times])
        found = look_up(write(tmp_path, times, air).at(1.0), asked, precision)
        expected = np.stack([np.interp(asked, times, axis) for axis in air.T], axis=1)
        np.testing.assert_allclose(found, expected, atol=tolerance)


def test_series_is_the_same_at_all_heights_and_holds_its_ends(tmp_path: Path) -> None:
    air = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, -3.0]])
    series = cast(write(tmp_path, np.array([0.0, 4.0]), air).at(4.0), np.float32)
    found = series.velocity_ned(jnp.arange(5, dtype=jnp.float32), jnp.int32(1), jnp.float32(0.0))
    np.testing.assert_allclose(found.stack(), np.tile([1.25, 2.5, 1.5], (5, 1)))
    np.testing.assert_allclose(look_up(series, np.array([-5.0, 4.0, 9.0]), "float32"), air[[0, 1, 1]])


def test_columns_in_any_order_beside_others(tmp_path: Path) -> None:
    path = tmp_path / "anemometer.csv"
    path.write_text("\ufeffdown [m/s], east ,note,time[s],north\n0.5,2,calm,0,1\n0.5,4,,2.5,3\n", encoding="utf-8")
    series = WindFile(str(path)).at(2.5)
    np.testing.assert_allclose(look_up(series, np.array([1.25]), "float64"), [[2.0, 3.0, 0.5]])


def test_an_anemometer_has_speed_and_bearing(tmp_path: Path) -> None:
    """Wind from the west moves to the east, wind from 30 degrees by -cos 30 and -sin 30; between rows it is linear."""
    path = tmp_path / "anemometer.csv"
    path.write_text("time [s],speed [m/s],wind_from [deg]\n0,4,270\n2,8,30\n", encoding="utf-8")
    found = look_up(WindFile(str(path)).at(2.0), np.array([0.0, 2.0, 1.0]), "float64")
    expected = [[0.0, 4.0, 0.0], [-6.9282032, -4.0, 0.0], [-3.4641016, 0.0, 0.0]]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_without_a_column_of_its_own_the_air_does_not_rise(tmp_path: Path) -> None:
    path = tmp_path / "level.csv"
    path.write_text("time,north,east\n0,1,2\n2,1,2\n", encoding="utf-8")
    np.testing.assert_allclose(look_up(WindFile(str(path)).at(2.0), np.array([1.0]), "float64"), [[1.0, 2.0, 0.0]])


GOOD = "time,north,east,down\n0,1,2,3\n1,1,2,3\n"
BAD = {
    "gap": (GOOD + "12.5,0,0,0\n", ["line 4", "'time'", "gap of 11.5 s", "allowed: 10 s (max_gap)"]),
    "time repeats": (GOOD + "1,0,0,0\n", ["line 4", "'time'", "1 s does not come after 1 s", "must increase"]),
    "time falls": (GOOD + "0.5,0,0,0\n", ["line 4", "'time'", "0.5 s does not come after 1 s"]),
    "times coincide": (GOOD + "1.00000001,0,0,0\n", ["line 4", "'time'", "1.00000001 s follows within 0.0001 s"]),
    "not seconds": ("time,north,east,down\n2.1e9,0,0,0\n", ["line 2", "'time'", "seconds since the start"]),
    "nan": (GOOD + "2,0,nan,0\n", ["line 4", "'east'", "'nan' is not a finite number"]),
    "infinite": (GOOD + "2,0,0,-inf\n", ["line 4", "'down'", "'-inf' is not a finite number"]),
    "empty field": (GOOD + "2,,0,0\n", ["line 4", "'north'", "'' is not a finite number"]),
    "text": (GOOD + "2,0,0,1_0\n", ["line 4", "'down'", "'1_0' is not a finite number"]),
    "short row": (GOOD + "2,0,0\n", ["line 4", "3 fields, the header has 4"]),
    "empty row": (GOOD + "\n2,0,0,0\n", ["line 4", "0 fields"]),
    "another unit": (
        "time [s],north [km/h],east,down\n0,1,2,3\n",
        ["line 1", "column 'north' is in km/h; expected m/s"],
    ),
    "missing column": ("time,nort,east,down\n0,1,2,3\n", ["line 1", "no column 'north'", "did you mean 'nort'?"]),
    "no bearing": (
        "time,speed,direction\n0,1,2\n1,2,3\n",
        ["line 1", "no column 'wind_from'; found time, speed, direction; expected"],
    ),
    "neither": (
        "time,v_n,v_e\n0,1,2\n1,2,3\n",
        ["no column 'north'; found time, v_n, v_e; expected time, north, east or time, speed, wind_from"],
    ),
    "speed below 0": ("time,speed,wind_from\n0,1,2\n1,-2,3\n", ["column 'speed': -2 m/s; allowed: from 0"]),
    "clock": ("time,north,east\n10:00:01,1,2\n", ["line 2", "'10:00:01'", "give seconds since the start"]),
    "no header": ("0,1,2,3\n1,1,2,3\n", ["line 1", "no column 'time'"]),
    "column twice": ("time,north,east,down,north\n", ["line 1", "'north' is there 2 times"]),
    "empty": ("", ["line 1", "the file is empty"]),
    "empty lines": ("\n\n", ["line 1", "its first line is empty"]),
    "one row": ("time,north,east,down\n0,1,2,3\n", ["1 rows under the header", "at least 2"]),
    "bad quotes": (GOOD + '2,"0"1,0,0\n', ["line 4", "not CSV"]),
}


@pytest.mark.parametrize("name", BAD)
def test_faults_are_named_with_line_and_column(tmp_path: Path, name: str) -> None:
    content, expected = BAD[name]
    path = tmp_path / "wind.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(UsageError) as raised:
        WindFile(str(path)).at(1.0)
    message = str(raised.value)
    assert message.startswith(str(path))
    for part in expected:
        assert part in message


def test_no_such_file_not_text_and_a_folder(tmp_path: Path) -> None:
    (tmp_path / "wind_north.csv").write_text(GOOD, encoding="utf-8")
    with pytest.raises(UsageError, match=r"No such file.*did you mean 'wind_north.csv'"):
        WindFile(str(tmp_path / "wind_nort.csv")).at(1.0)
    (tmp_path / "binary.csv").write_bytes(b"time,north,east,down\n\xff,0,0,0\n")
    with pytest.raises(UsageError, match="byte 0xff is not UTF-8"):
        WindFile(str(tmp_path / "binary.csv")).at(1.0)
    with pytest.raises(UsageError, match="cannot be read"):
        WindFile(str(tmp_path)).at(1.0)


@pytest.mark.parametrize(("first", "last"), [(0.5, 100.0), (0.0, 59.9)])
def test_run_longer_than_the_series_is_refused(tmp_path: Path, first: float, last: float) -> None:
    table = write(tmp_path, np.array([first, last]), np.zeros((2, 3)))
    with pytest.raises(UsageError, match=f"from {first:g} s to {last:g} s.*0 s to 60 s"):
        table.at(60.0)


def veering(**changes: Any) -> VeeringShear:
    return VeeringShear(**({"speed_20ft": 6.0, "wind_from_rad": math.radians(250.0)} | changes))


def profile(wind: VeeringShear, heights: Any) -> Array:
    """Velocities (n, 3) in double precision."""
    with jax.enable_x64(True):
        height = jnp.asarray(np.array(heights, np.float64))
        found = cast(wind, np.float64).velocity_ned(height, jnp.int32(0), jnp.asarray(0.0))
        return np.asarray(found.stack())


def test_without_veer_it_is_the_logarithmic_shear() -> None:
    heights = np.array([-1.0, 0.0, 0.04, 2.0, 6.096, 100.0, 300.0])
    with jax.enable_x64(True):
        shear = cast(LogShear(6.0, math.radians(250.0)), np.float64)  # type: ignore[arg-type]
        expected = shear.velocity_ned(jnp.asarray(heights)).stack()
    np.testing.assert_allclose(profile(veering(), heights), expected, atol=1e-12)


@pytest.mark.parametrize("kind", ["log", "power"])
def test_direction_turns_with_height(kind: str) -> None:
    heights = np.array([1.0, 6.096, 56.096, 106.096, 306.096])
    found = profile(veering(veer_per_100m_rad=math.radians(12.0), profile=kind), heights)
    bearing = np.degrees(np.arctan2(-found[:, 1], -found[:, 0])) % 360.0
    np.testing.assert_allclose(bearing, 250.0 + 0.12 * (heights - 6.096), atol=1e-9)
    np.testing.assert_array_equal(found[:, 2], 0.0)


def test_power_law() -> None:
    heights = np.array([-5.0, 0.0, 1e-9, 3.0, 6.096, 200.0])
    speed = np.linalg.norm(profile(veering(profile="power", exponent=0.2), heights), axis=1)
    np.testing.assert_allclose(speed, 6.0 * (np.maximum(heights, 0.0) / 6.096) ** 0.2, rtol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["log", "power"])
def test_gradients_are_finite_on_the_ground(kind: str) -> None:
    def speed(wind: VeeringShear, height: Any) -> Any:
        air = wind.velocity_ned(height, jnp.int32(0), jnp.float32(0.0))
        return jnp.sum(air.x + 2.0 * air.y)

    wind = cast(veering(profile=kind, veer_per_100m_rad=0.1), np.float32)
    slopes = jax.grad(speed, argnums=(0, 1))(wind, jnp.array([-1.0, 0.0, 1e-6, 50.0], jnp.float32))
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(slopes))
