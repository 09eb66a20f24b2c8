"""Limits of the standard atmosphere and of the wind of a grid, and what the first-order gusts draw."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Drawn
from qrsim.core.vectors import Vec3
from qrsim.engine.settings import quick_jit
from qrsim.errors import UsageError
from qrsim.models.atmosphere.standard import air_above, density, pressure, temperature
from qrsim.models.atmosphere.turbulence import DrydenFirstOrder
from qrsim.models.atmosphere.wind_grid import WindGrid, WindGridFile, _cell

Floats = np.ndarray[Any, Any]


def test_first_order_gusts_draw_a_normal_for_each_axis() -> None:
    assert DrydenFirstOrder.normals == 3
    gusts = DrydenFirstOrder(speed_20ft=8.0, wind_from_rad=0.0)  # type: ignore[arg-type]
    state = gusts.init(Drawn(tuple(np.array([[1.0], [2.0], [3.0]]))))
    np.testing.assert_array_equal(np.ravel([state.gust.x, state.gust.y, state.gust.z]), [1.0, 2.0, 3.0])


def test_standard_atmosphere_at_the_tropopause() -> None:
    """ISO 2533:1975, at a geopotential height of 11 km: 216.65 K, 22632 Pa and 0.36392 kg/m^3."""
    assert temperature(11_000.0) == pytest.approx(216.65, rel=1e-12)
    assert pressure(11_000.0) == pytest.approx(22632.06, rel=1e-6)
    assert density(11_000.0) == pytest.approx(0.363918, rel=3e-6)
    found = quick_jit(air_above)(np.array([11_000.0, 60_000.0], np.float32), 288.15, 101325.0)
    np.testing.assert_allclose([part[0] for part in found], [22632.06, 216.65, 0.363918], rtol=1e-5)
    # Its straight line reaches nought at 44 km: a tenth of the temperature below is the least.
    assert float(found.temperature[1]) == pytest.approx(28.815, rel=1e-6)


# The wind of a grid: six rows to the north from -100 m on, 20 m apart, and four columns to the east.


def grid(air: Floats, seconds: tuple[int, ...]) -> WindGrid:
    """Return a wind of a velocity north (T, Z, Y, X), none east and down, at levels of 0, 10 and 110 m."""
    none = np.zeros_like(air)
    content: dict[str, Any] = {
        "air_ned": Vec3(air, none, none),  # type: ignore[arg-type]
        "corner": (-100.0, 0.0),
        "spacing": (20.0, 50.0),
        "levels": np.array([0.0, 10.0, 110.0]),
        "seconds": np.array(seconds, np.int32),
        "fraction": np.zeros(len(seconds)),
    }
    return WindGrid(**content, file="grid").averaged()


@quick_jit
def north_of(wind: WindGrid, north: Any, seconds: Any) -> tuple[Any, Any]:
    """Return the wind to the north at places (n,) of a row through the second column, on the ground, and its mean."""
    zero = jnp.zeros_like(north)
    given: dict[str, Any] = {"position_ned": Vec3(north, zero + 50.0, zero)}
    return wind.velocity_ned(zero, seconds, jnp.float32(0.0), **given).x, wind.mean_velocity_ned(zero).x


def squares(factors: tuple[float, ...]) -> Floats:
    """Return a wind (T, 3, 6, 4) of 0, 1, 4, 9, 16 and 25 m/s in its rows, times a factor of each time."""
    rows = np.arange(6.0) ** 2
    return np.asarray(np.array(factors)[:, None, None, None] * np.ones((1, 3, 1, 4)) * rows[None, None, :, None])


@pytest.mark.long
def test_a_grid_of_one_time_is_steady_and_one_of_two_is_linear_between_them() -> None:
    """Halfway along the last cell from 16 to 25 m/s, at its end and beyond; the mean of the rows is 55/6."""
    places, rows = np.array([-10.0, 0.0, 30.0], np.float32), np.array([20.5, 25.0, 25.0])
    steady, rising = grid(squares((1.0,)), (0,)), grid(squares((1.0, 3.0)), (0, 10))
    # After its last time it stays.
    for wind, seconds, factor, mean in (
        (steady, 0, 1.0, 1.0),
        (steady, 7, 1.0, 1.0),
        (rising, 0, 1.0, 2.0),
        (rising, 5, 2.0, 2.0),
        (rising, 10, 3.0, 2.0),
        (rising, 11, 3.0, 2.0),
        (rising, 14, 3.0, 2.0),
    ):
        found, over_all = north_of(wind, places, np.int32(seconds))
        np.testing.assert_allclose(found, factor * rows, rtol=1e-6)
        np.testing.assert_allclose(over_all, mean * 55.0 / 6.0, rtol=1e-6)


def test_the_last_cell_ends_at_the_last_point() -> None:
    """Of six points there are the cells 0 to 4, so that none reads beyond the points."""
    number, share = _cell(jnp.array([4.0, 4.75, 5.0, 9.0], jnp.float32), 6)
    assert np.asarray(number).tolist() == [4, 4, 4, 4]
    assert np.asarray(share).tolist() == [0.0, 0.75, 1.0, 1.0]


@pytest.mark.parametrize(
    ("south", "north", "begin", "rows"),
    [
        (-100.0, 0.0, -100.0, 6),  # all of it
        (-95.0, -90.0, -100.0, 2),  # within the first cell
        (-15.0, -5.0, -20.0, 2),  # within the last one
        (-60.0, -60.0, -60.0, 2),  # a line through a row
        (0.0, 0.0, -20.0, 2),  # and through the last row
        (-75.0, -45.0, -80.0, 3),
    ],
)
def test_an_area_keeps_the_rows_around_it(south: float, north: float, begin: float, rows: int) -> None:
    """Never fewer than two, between which there is a velocity."""
    part = grid(squares((1.0,)), (0,)).within((south, north, 0.0, 150.0), None)
    assert part.air_ned.x.shape == (1, 3, rows, 4)
    assert float(part.corner[0]) == pytest.approx(begin)


def test_an_area_may_be_a_millionth_larger() -> None:
    """Of a row's distance of 20 m, and of the levels' reach of 110 m."""
    wind = grid(squares((1.0,)), (0,))
    for south, north, top in ((9e-7, 0.0, 0.0), (0.0, 9e-7, 0.0), (0.0, 0.0, 9e-7)):
        part = wind.within((-100.0 - 20.0 * south, 20.0 * north, 0.0, 150.0), 110.0 * (1.0 + top))
        assert part.air_ned.x.shape == (1, 3, 6, 4)
        assert wind.beyond((-100.0 - 20.0 * south, 20.0 * north, 0.0, 150.0), 110.0 * (1.0 + top)) == []
    for south, north in ((1.1e-6, 0.0), (0.0, 1.1e-6)):
        (words,) = wind.beyond((-100.0 - 20.0 * south, 20.0 * north, 0.0, 150.0), 110.0)
        assert "covers -100 to 0 m north" in words
    (words,) = wind.beyond(None, 110.0 * (1.0 + 1.1e-6))
    assert "reaches up to 110 m" in words


def written(folder: Path, times: int, x: Floats) -> str:
    """Write a wind of 1 m/s along each axis, at a number of times, 10 s apart."""
    xarray = pytest.importorskip("xarray", reason="python -m pip install 'qrsim[wind]'")
    pytest.importorskip("netCDF4", reason="python -m pip install 'qrsim[wind]'")
    air = np.ones((times, 2, 2, len(x)))
    axes = {"z": np.array([0.0, 10.0]), "y": np.array([0.0, 10.0]), "x": x}
    coordinates: dict[str, Any] = {name: (name, values, {"units": "m"}) for name, values in axes.items()}
    coordinates["time"] = ("time", 10.0 * np.arange(times), {"units": "s"})
    content = xarray.Dataset({name: (("time", *axes), air, {"units": "m s-1"}) for name in "uvw"}, coordinates)
    content.to_netcdf(folder / "wind.nc")
    return str(folder / "wind.nc")


def test_a_file_of_one_time_lasts_for_any_run_and_one_of_none_is_refused(tmp_path: Path) -> None:
    x = np.array([0.0, 10.0, 20.0])
    assert WindGridFile(written(tmp_path, 1, x)).at(100.0).air_ned.x.shape == (1, 2, 2, 3)
    with pytest.raises(UsageError, match=re.escape("'time' has 0 values; expected 1 or more finite numbers")):
        WindGridFile(written(tmp_path, 0, x)).at(100.0)


def test_a_files_columns_may_be_uneven_by_a_thousandth(tmp_path: Path) -> None:
    """Steps of 10 m and of that and 0.9 or 1.1 thousandths more."""
    assert WindGridFile(written(tmp_path, 1, np.array([0.0, 10.0, 20.009]))).at(1.0).air_ned.x.shape == (1, 2, 2, 3)
    with pytest.raises(UsageError, match=re.escape("'x' is not evenly spaced: from 10 to 10.011 m")):
        WindGridFile(written(tmp_path, 1, np.array([0.0, 10.0, 20.011]))).at(1.0)
