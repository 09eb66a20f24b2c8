"""Run folders of made-up flights, whose summary follows from a few numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from qrsim.runs import Column, RunInfo, RunWriter

STEP, SPEED, SPACING, HEIGHT = 0.02, 2.0, 30.0, 20.0
FIX_TICKS = 10
GNSS_ERROR = np.array([1.0, 2.0, -3.0])
MEAN, GUST = np.array([3.0, 4.0, 0.0]), np.array([0.0, 0.0, 12.0])
AXES = "xyz"


def vector_columns(name: str, unit: str) -> list[Column]:
    return [Column(f"{name}.{axis}", unit, "", "float64") for axis in AXES]


def vector_values(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """(T, n, 3) by column."""
    return {f"{name}.{axis}": values[..., i] for i, axis in enumerate(AXES)}


def write_flight(
    folder: Path,
    *,
    vehicles: int = 2,
    ticks: int = 60,
    wind: float = 1.0,
    sensors: Sequence[str] = ("gnss", "barometer"),
    stops: dict[int, int] | None = None,
    killed_after: Sequence[str] | None = None,
    end: str = "finished",
    every: dict[str, int] | None = None,
    seed: int = 5,
    names: Sequence[str] | None = None,
    scenario_yaml: str = "",
    change: Callable[[dict[str, dict[str, np.ndarray]]], None] = lambda values: None,
) -> Path:
    """Record vehicles that fly north at SPEED, and east after half of the time; each has its own line.

    Args:
        folder: to make.
        vehicles, ticks: how many.
        wind: factor of MEAN and GUST; every vehicle has the same.
        sensors: which of the two there are.
        stops: vehicle -> tick from which on it stands still and measures nothing.
        killed_after: None, or the streams that were still written at the last flush before the process was killed.
        end: final state.
        every: decimation of the streams.
        seed, scenario_yaml: what is noted in the run folder.
        names: of the vehicles; v0, v1, ... by default.
        change: is given stream -> column -> (T, n) values before they are recorded; it may add and remove columns.
    """
    names = tuple(names or (f"v{i}" for i in range(vehicles)))
    info = RunInfo.collect(
        scenario="made_up",
        seed=seed,
        precision="float32",
        time_step=STEP,
        vehicles=names,
        every=every,
        command_line=["qrsim"],
    )
    parts = _values(vehicles, ticks, wind, sensors, stops or {})
    change(parts)
    columns = {
        "truth": [*vector_columns("position_ned", "m"), Column("valid", "", "", "bool")],
        "measurements": [
            *(vector_columns("gnss.position_ned", "m") if "gnss" in sensors else []),
            *([Column("barometer.height", "m", "", "float64")] if "barometer" in sensors else []),
        ],
        "commands": vector_columns("setpoint.position_ned", "m"),
        "wind": [*vector_columns("mean_ned", "m/s"), *vector_columns("gust_ned", "m/s")],
    }
    for stream, known in columns.items():
        named = {column.name: column for column in known}
        columns[stream] = [named.get(name) or Column(name, "", "", "float64") for name in parts[stream]]
    writer = RunWriter.create(
        folder, info=info, scenario_yaml=scenario_yaml, columns=columns, flush_rows=10**9, flush_seconds=1e9
    )
    half = ticks // 2
    for first, last in ((0, half), (half, ticks)):
        for stream, values in parts.items():
            if first and killed_after is not None and stream not in killed_after:
                continue
            numbers = np.arange(first, last)
            writer.append(stream, numbers, numbers * STEP, {name: v[first:last] for name, v in values.items()})
        for vehicle, tick in (stops or {}).items():
            if first <= tick < last:
                message = f"{names[vehicle]} stopped"
                writer.append_event(tick * STEP, tick, names[vehicle], "out_of_area", "position_ned.x", 1.0, message)
        if not first:
            writer.append_event(half * STEP, half, names[0], "waypoint_reached", "waypoint", 1.0, "")
            writer.append_event(half * STEP, half, names[0], "command_clipped")
        if ticks:
            writer.flush()
    if killed_after is None and end != "running":
        writer.close(end)  # type: ignore[arg-type]
    return folder


def _values(
    vehicles: int, ticks: int, wind: float, sensors: Sequence[str], stops: dict[int, int]
) -> dict[str, dict[str, np.ndarray]]:
    half = ticks // 2
    travelled = SPEED * STEP * np.arange(ticks)
    position = np.zeros((ticks, vehicles, 3))
    position[..., 0] = np.minimum(travelled, SPEED * STEP * half)[:, None]
    position[..., 1] = np.maximum(travelled - SPEED * STEP * half, 0.0)[:, None] + SPACING * np.arange(vehicles)
    position[..., 2] = -HEIGHT
    corner, target = SPEED * STEP * half, np.zeros((ticks, vehicles, 3))
    target[..., 0], target[..., 2] = corner, -HEIGHT
    target[..., 1] = SPACING * np.arange(vehicles)
    target[half:, :, 1] += corner
    valid = np.ones((ticks, vehicles), bool)
    for vehicle, tick in stops.items():
        position[tick:, vehicle] = position[tick, vehicle]
        valid[tick:, vehicle] = False
    fixes = np.arange(ticks) // FIX_TICKS * FIX_TICKS
    reported = np.where(valid[..., None], position[fixes] + GNSS_ERROR, np.nan)
    measured = vector_values("gnss.position_ned", reported) if "gnss" in sensors else {}
    if "barometer" in sensors:
        measured["barometer.height"] = np.where(valid, HEIGHT + 0.5, np.nan)
    air = np.ones((ticks, vehicles, 1)) * wind
    return {
        "truth": {**vector_values("position_ned", position), "valid": valid},
        "measurements": measured,
        "commands": vector_values("setpoint.position_ned", target),
        "wind": {**vector_values("mean_ned", air * MEAN), **vector_values("gust_ned", air * GUST)},
    }
