"""Errors of estimates of wind, biases and fields: the rows that only some filters have, of a made-up flight."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.runs import Column, RunInfo, RunWriter, open_run
from qrsim.runs.estimate_figure import draw_estimate

TICKS, STEP = 50, 0.02
AXES, ANGLES = ("x", "y", "z"), ("roll", "pitch", "yaw")
# Mean wind and gust, north and east [m/s], what the filter says of their sum, and the std that it states.
MEAN, GUST, SAID, STD = (3.0, -2.0), (0.5, 0.25), (4.0, -1.5), 0.4
EARTH, OWN = (19.0, -0.5, 44.0), (1.0, -2.0, 3.0)


def flight(folder: Path, aided: bool) -> Path:
    """Record one vehicle at rest, facing north, on a filter that is right but for the wind."""
    still = dict.fromkeys([f"position_ned.{axis}" for axis in AXES] + [f"attitude.{angle}" for angle in ANGLES], 0.0)
    truth = still | {f"velocity_body.{axis}": 0.0 for axis in AXES}
    said = still | {f"velocity_ned.{axis}": 0.0 for axis in AXES}
    if aided:
        said |= {"wind_north": SAID[0], "wind_east": SAID[1]}
        said |= {f"earth_field_ned.{axis}": value for axis, value in zip(AXES, EARTH, strict=True)}
        said |= {f"field_bias.{axis}": value for axis, value in zip(AXES, OWN, strict=True)}
    wind = {
        f"{kind}.{axis}": value
        for kind, values in (("mean_ned", MEAN), ("gust_ned", GUST))
        for axis, value in zip("xy", values, strict=True)
    }
    streams: dict[str, dict[str, float]] = {
        "truth": truth,
        "commands": {f"estimate.{name}": value for name, value in said.items()}
        | {f"estimate_std.{name}": STD for name in said},
        "wind": wind,
    }
    info = RunInfo.collect(
        scenario="made_up", seed=1, precision="float32", time_step=STEP, vehicles=("v0",), command_line=["qrsim"]
    )
    columns = {stream: [Column(name, "", "", "float64") for name in values] for stream, values in streams.items()}
    columns["truth"].append(Column("valid", "", "", "bool"))
    writer = RunWriter.create(folder, info=info, scenario_yaml="", columns=columns)
    ticks = np.arange(TICKS)
    for stream, values in streams.items():
        rows: dict[str, Any] = {name: np.full((TICKS, 1), value) for name, value in values.items()}
        rows |= {"valid": np.ones((TICKS, 1), bool)} if stream == "truth" else {}
        writer.append(stream, ticks, ticks * STEP, rows)
    writer.close("finished")
    return folder


@pytest.fixture(scope="module")
def panels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Panels that are seen, by title."""
    run = open_run(flight(tmp_path_factory.mktemp("aided") / "run", aided=True))
    return {axes.get_title(loc="left"): axes for axes in draw_estimate(run).figure.axes if axes.get_visible()}


def values(axes: Any) -> Any:
    """What the line of the only vehicle has; another line is at 0 from side to side."""
    [line] = [line for line in axes.lines if len(line.get_xdata()) == TICKS]
    return line.get_ydata()


def band(axes: Any) -> tuple[float, float]:
    """Lower and upper edge of what is shaded."""
    [shade] = axes.collections
    edges = shade.get_paths()[0].vertices[:, 1]
    return edges.min(), edges.max()


def test_an_estimate_of_wind_has_a_row_with_two_panels(panels: dict[str, Any]) -> None:
    """It errs by what it says minus mean and gust: 4 - 3.5 and -1.5 + 1.75 m/s, and 3 std are 1.2 m/s."""
    assert len(panels) == 9 + 2 + 3 + 3
    np.testing.assert_allclose(values(panels["wind, north [m/s]"]), 0.5)
    np.testing.assert_allclose(values(panels["wind, east [m/s]"]), 0.25)
    assert band(panels["wind, east [m/s]"]) == pytest.approx((-1.2, 1.2))


def test_fields_are_drawn_as_they_are_estimated(panels: dict[str, Any]) -> None:
    """The log does not know the true ones; the band is about the estimate."""
    np.testing.assert_allclose(values(panels["earth field, down [µT]"]), 44.0)
    np.testing.assert_allclose(values(panels["earth field, north [µT]"]), 19.0)
    np.testing.assert_allclose(values(panels["field bias, y [µT]"]), -2.0)
    assert band(panels["field bias, y [µT]"]) == pytest.approx((-3.2, -0.8))


def test_without_them_there_are_three_rows(tmp_path: Path) -> None:
    figure = draw_estimate(open_run(flight(tmp_path / "run", aided=False)))
    assert len(figure.axes) == 9
    assert not [axes for axes in figure.axes if "wind" in axes.get_title(loc="left")]
    assert "biases" not in figure.get_suptitle()
