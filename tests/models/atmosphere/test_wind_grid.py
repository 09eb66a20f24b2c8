"""The wind of a grid: closed forms that are linear along each axis, and files with wrong units, frames and sizes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.atmosphere.wind import mean_wind_at
from qrsim.models.atmosphere.wind_grid import WindGridFile

INSTALL = "python -m pip install 'qrsim[wind]'"
X, Y = np.arange(-300.0, 301.0, 100.0), np.arange(-200.0, 201.0, 80.0)
Z, T = np.array([2.0, 5.0, 20.0, 60.0, 130.0]), np.array([0.0, 40.0, 100.0])
NAMES = {"u": "eastward_wind", "v": "northward_wind", "w": "upward_air_velocity"}


def east(t: Any, z: Any, y: Any, x: Any) -> Any:
    return 3.0 + 0.01 * x - 0.02 * y + 0.03 * z + 0.004 * t + 1e-4 * x * y + 2e-6 * x * y * z + 1e-7 * t * x * z


def north(t: Any, z: Any, y: Any, x: Any) -> Any:
    return -2.0 + 0.005 * y + 1e-4 * x * z


def up(t: Any, z: Any, y: Any, x: Any) -> Any:
    return 0.5 + 0.001 * x + 0.002 * t


def dataset(**changes: Any) -> Any:
    """A wind that is linear along each axis, as a file has it."""
    xarray = pytest.importorskip("xarray", reason=INSTALL)
    t, z, y, x = np.meshgrid(T, Z, Y, X, indexing="ij")
    functions = {"u": east, "v": north, "w": up}
    variables = {
        name: (("time", "z", "y", "x"), function(t, z, y, x), {"units": "m s-1", "standard_name": NAMES[name]})
        for name, function in functions.items()
    }
    coordinates = {name: (name, values, {"units": "m"}) for name, values in (("z", Z), ("y", Y), ("x", X))}
    return xarray.Dataset(variables, {**coordinates, "time": ("time", T, {"units": "s"})})


def written(folder: Path, content: Any, **how: Any) -> str:
    pytest.importorskip("netCDF4", reason=INSTALL)
    path = folder / "wind.nc"
    content.to_netcdf(path, **how)
    return str(path)


def blown(wind: Any, places: Any, time: float) -> Any:
    """The air at places (n, 3) north, east and up."""
    position = Vec3(*(jnp.asarray(each) for each in (places[:, 0], places[:, 1], -places[:, 2])))
    parts = jnp.int32(int(time)), jnp.asarray(time % 1.0)
    return np.asarray(mean_wind_at(wind, jnp.asarray(places[:, 2]), position, parts).stack())


def expected(places: Any, time: float) -> Any:
    y, x, z = places.T
    return np.stack([north(time, z, y, x), east(time, z, y, x), -up(time, z, y, x)], axis=1)


def somewhere(count: int = 200) -> Any:
    draw = np.random.default_rng(4).uniform
    return np.stack([draw(-200, 200, count), draw(-300, 300, count), draw(2, 130, count)], axis=1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("wind"), dataset())


@pytest.mark.parametrize("time", [0.0, 17.25, 40.0, 99.5])
def test_what_is_linear_along_each_axis_is_exact(whole, time):
    places = somewhere()
    found = blown(WindGridFile(whole).at(100.0), places, time)
    # Single precision: the largest terms are some 40 m/s.
    np.testing.assert_allclose(found, expected(places, time), rtol=0.0, atol=1e-4)


@pytest.mark.long
def test_points_of_the_grid_and_beyond_its_edges(whole):
    wind = WindGridFile(whole).at(100.0)
    corners = np.array([[200.0, 300.0, 130.0], [-200.0, -300.0, 2.0], [40.0, 100.0, 60.0]])
    beyond = np.array([[900.0, 301.0, 1e4], [-201.0, -4000.0, -3.0], [40.0, 100.0, 60.0]])
    for places in (corners, beyond):
        np.testing.assert_allclose(blown(wind, places, 0.0), expected(corners, 0.0), rtol=0.0, atol=1e-4)
    # What is nowhere does not make others so.
    lost = np.array([[np.nan, np.inf, np.nan], [40.0, 100.0, 60.0]])
    assert np.isfinite(blown(wind, lost, 0.0)).all()


def test_rows_from_the_north_levels_from_above_and_the_classic_format(tmp_path, whole):
    turned = dataset().isel(y=slice(None, None, -1), z=slice(None, None, -1)).transpose("x", "time", "z", "y")
    turned["z"] = ("z", -turned["z"].values, {"units": "m", "positive": "down"})
    places = somewhere()
    found = blown(WindGridFile(written(tmp_path, turned, format="NETCDF3_CLASSIC")).at(100.0), places, 12.5)
    np.testing.assert_array_equal(found, blown(WindGridFile(whole).at(100.0), places, 12.5))


@pytest.mark.parametrize(
    ("unit", "seconds"),
    [
        ("hours since 2026-01-01 00:00", 3600.0),
        ("Hours Since 2026-01-01", 3600.0),
        ("minutes since 2026-01-01", 60.0),
        ("days since 1970-01-01", 86_400.0),
        ("milliseconds", 1e-3),
    ],
)
def test_times_in_other_units(tmp_path, whole, unit, seconds):
    """The last is 100 s after the first, so it covers a run of 100 s."""
    other = dataset()
    other["time"] = ("time", 20_000.0 + T / seconds, {"units": unit})
    found = blown(WindGridFile(written(tmp_path, other)).at(100.0), somewhere(), 90.0)
    np.testing.assert_allclose(found, blown(WindGridFile(whole).at(100.0), somewhere(), 90.0), rtol=0.0, atol=1e-5)


def test_its_origin_its_start_and_heights_over_the_origin(whole):
    moved = WindGridFile(whole, origin_north=50.0, origin_east=-70.0, start=30.0, heights="origin").at(70.0)
    places = np.array([[10.0, 20.0, 15.0], [-90.0, 5.0, 33.0]])
    there = places + np.array([50.0, -70.0, 0.0])
    position = Vec3(*(jnp.asarray(each) for each in (places[:, 0], places[:, 1], -places[:, 2])))
    # Heights above ground are none of its business then.
    found = mean_wind_at(moved, jnp.full(2, 90.0), position, (jnp.int32(8), jnp.float32(0.5)))
    np.testing.assert_allclose(np.asarray(found.stack()), expected(there, 38.5), rtol=0.0, atol=1e-4)


def test_only_what_the_area_needs_is_kept(whole):
    wind = WindGridFile(whole).at(100.0)
    part = wind.within((-100.0, 90.0, 20.0, 180.0), 120.0)
    assert part.air_ned.x.shape == (3, 5, 4, 3)
    places = np.array([[-100.0, 20.0, 50.0], [90.0, 180.0, 3.0], [0.0, 101.0, 119.0]])
    np.testing.assert_allclose(blown(part, places, 60.0), expected(places, 60.0), rtol=0.0, atol=1e-4)
    assert wind.beyond((-100.0, 200.0, 20.0, 180.0), 130.0) == []
    north, up = wind.beyond((-100.0, 201.0, 20.0, 180.0), 131.0)[::-1]
    assert north.endswith("covers -200 to 200 m north; world.area asks for -100 to 201 m")
    assert up.endswith("reaches up to 130 m; world.area reaches up to 131 m")
    # Beyond, the air has the edge's velocity: at 250 m north and 200 m up that of 200 m north and 130 m.
    wide = wind.within((-100.0, 260.0, 20.0, 180.0), 300.0)
    beyond = blown(wide, np.array([[250.0, 100.0, 200.0]]), 60.0)
    np.testing.assert_allclose(beyond, expected(np.array([[200.0, 100.0, 130.0]]), 60.0), rtol=0.0, atol=1e-4)
    with pytest.raises(
        UsageError, match=re.escape("covers -200 to 200 m north, none of world.area, which is 300 to 400")
    ):
        wind.within((300.0, 400.0, 20.0, 180.0), None)


def test_the_largest_speed_at_a_height(whole):
    t, z, y, x = np.meshgrid(T, [20.0, 60.0], Y, X, indexing="ij")
    by_hand = np.hypot(east(t, z, y, x), north(t, z, y, x)).max(axis=(0, 2, 3))
    found = WindGridFile(whole).at(100.0).largest_speed(np.array([20.0, 60.0, 40.0]))
    np.testing.assert_allclose(found, [*by_hand, by_hand.mean()], rtol=1e-6)


def holed(content: Any) -> Any:
    content["u"][0, 1, 2, 3] = np.nan
    return content


def units(of: str, what: str | None) -> Any:
    def change(content: Any) -> Any:
        content[of].attrs.pop("units", None)
        if what is not None:
            content[of].attrs["units"] = what
        return content

    return change


def filled(content: Any) -> Any:
    content["v"][2, 4, 1, 0] = 1e20
    return content


def uneven(content: Any) -> Any:
    return content.isel(x=[0, 1, 2, 4, 5, 6])


def turned(content: Any) -> Any:
    return content.rename(u="v", v="u")


BAD = {
    "no units": (units("v", None), "'v' has no units; expected the attribute units: 'm s-1'"),
    "knots": (units("u", "knots"), "'u' has the units 'knots'; expected 'm s-1'"),
    "kilometres": (units("x", "km"), "'x' has the units 'km'; expected 'm'"),
    "no length": (units("z", None), "'z' has no units; expected the attribute units: 'm'"),
    "degrees": (units("x", "degrees_east"), "'x' is in degrees_east; expected metres"),
    "months": (
        units("time", "months since 2026-01-01"),
        "'time' has the units 'months since 2026-01-01'; expected 's' or 'seconds since ...', or the same with",
    ),
    "a hole": (holed, "1 of 630 points have no velocity; missing: calm takes the air there for still"),
    "a fill value": (filled, "'v' reaches 1e+20 m/s; allowed: 150"),
    "uneven": (uneven, "'x' is not evenly spaced: from 100 to 200 m"),
    "exchanged": (turned, "'u' has the standard name 'northward_wind', but is read as the velocity to the east"),
    "no w": (
        lambda each: each.drop_vars("w").assign(W=each["w"]),
        "has no 'w', the velocity upwards; known: u, v, W",
    ),
    "flat": (lambda each: each.isel(z=0, drop=True), "'u' is over time, y, x; it lacks z"),
    "one row": (lambda each: each.isel(y=[0]), "'y' has 1 values; expected 2 or more"),
    "names": (lambda each: each.rename(x="breadth"), "'u' has the dimension 'breadth', which is not known"),
    "backwards": (lambda each: each.isel(time=[2, 0, 1]), "'time' does not increase"),
    "short": (lambda each: each.isel(time=[0, 1]), "goes from 0 s to 40 s, which does not cover the run, 0 s to 100 s"),
    "other grids": (lambda each: each.assign(w=each["w"].isel(time=0)), "its velocities are on different grids"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_is_said(tmp_path, name):
    change, words = BAD[name]
    path = written(tmp_path, change(dataset()))
    with pytest.raises(UsageError, match=re.escape(words)) as caught:
        WindGridFile(path).at(100.0)
    assert str(caught.value).startswith(path)
    assert "\n" not in str(caught.value)


def test_air_inside_of_buildings_stands_still(tmp_path):
    wind = WindGridFile(written(tmp_path, holed(dataset())), missing="calm").at(100.0)
    there = np.array([[Y[2], X[3], Z[1]], [Y[2], X[2], Z[1]]])
    found = blown(wind, there, 0.0)
    np.testing.assert_array_equal(found[0], 0.0)
    np.testing.assert_allclose(found[1], expected(there, 0.0)[1], atol=1e-4)


def test_no_more_than_so_many_points_are_kept_or_read(tmp_path, whole):
    """Eight million in the area, thirty million in the file, a hundred thousand along an axis."""
    wind = WindGridFile(whole).at(100.0)
    netcdf = pytest.importorskip("netCDF4", reason=INSTALL)
    large = np.broadcast_to(np.float32(1.0), (3, 5, 1000, 534))
    with pytest.raises(UsageError, match=r"8010000 points in world\.area; allowed: 8000000"):
        replace(wind, air_ned=Vec3(large, large, large)).within(None, None)
    assert replace(wind, air_ned=Vec3(*(large[..., :533],) * 3)).within(None, None).air_ned.x.size == 7_995_000
    for sizes, words in (
        ((31, 1000, 1000), "31000000 points; allowed: 30000000, so cut it to the area"),
        ((2, 100_001, 2), "'y' has 100001 values; allowed: 100000"),
    ):
        path = tmp_path / f"{sizes[0]}.nc"
        with netcdf.Dataset(path, "w") as file:
            for name, size in zip("zyx", sizes, strict=True):
                file.createDimension(name, size)
                file.createVariable(name, "f8", (name,))[:] = np.arange(size)
                file[name].units = "m"
            for name in "uvw":
                # Never written, so it takes no room.
                file.createVariable(name, "f4", ("z", "y", "x"), chunksizes=(1, min(100, sizes[1]), 2)).units = "m s-1"
        with pytest.raises(UsageError, match=words):
            WindGridFile(str(path)).at(1.0)


def test_no_such_file_and_no_netcdf(tmp_path):
    (tmp_path / "wind.nc").write_text("u, v, w\n")
    with pytest.raises(UsageError, match=r"wind\.nc: is no NetCDF file"):
        WindGridFile(str(tmp_path / "wind.nc")).at(1.0)
    with pytest.raises(
        UsageError, match=re.escape("cannot be read: No such file or directory; did you mean 'wind.nc'")
    ):
        WindGridFile(str(tmp_path / "wnd.nc")).at(1.0)


@pytest.mark.long
@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("compiler", ["llvm", pytest.param("xla", marks=pytest.mark.nightly)])
def test_vehicles_feel_it_where_they_are(tmp_path, whole, compiler, monkeypatch):
    import qrsim

    monkeypatch.setenv("QRSIM_COMPILER", compiler)
    changes = [
        f"world.wind={{type: grid, file: {whole}}}",
        "duration=60",
        "world.area.z_min=-120",
        "world.turbulence={type: dryden, speed_20ft: 2, wind_from_rad: 1.0}",
    ]
    sim = qrsim.Simulation(qrsim.load_scenario("patrol_plain", changes, quiet=True).world(), seed=1)
    sim.reset()
    sim.step(ticks=400)
    assert sim.compiled_by[0] == compiler
    places = np.asarray(sim.truth.position_ned) * [1.0, 1.0, -1.0]
    sim.step()
    mean = sim.state.fleets[0].mean_wind_ned
    np.testing.assert_allclose(np.stack([mean.x, mean.y, mean.z], axis=1), expected(places, 8.0), rtol=0.0, atol=2e-4)


def test_its_mean_is_that_over_places_and_times_of_each_level(tmp_path: Path) -> None:
    """Of 3 + 0.03 z + 0.004 t east, -2 north and 0.5 + 0.002 t up from 0 to 100 s, 3.2 + 0.03 z, -2 and 0.6."""
    path = written(tmp_path, dataset())
    for wind in (WindGridFile(path).at(100.0), WindGridFile(path).at(100.0).within((-80.0, 80.0, -100.0, 100.0), 60.0)):
        found = wind.mean_velocity_ned(jnp.array([20.0, 40.0, 500.0])).stack()
        np.testing.assert_allclose(found[:2], [[-2.0, 3.8, -0.6], [-2.0, 4.4, -0.6]], atol=1e-5)
    np.testing.assert_allclose(found[2], [-2.0, 3.2 + 0.03 * 130.0, -0.6], atol=1e-5)
