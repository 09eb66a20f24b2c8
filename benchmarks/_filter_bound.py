"""The Kalman filter of the default scenario alone, in this package and by hand in C++ (``filter_bound.cc``).

Both fly the same states on the same readings, which stay as they are: IMU and height at every tick, a fix with its
velocity at every tenth and a magnetic field at every fifth tick.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import _common

SOURCE = Path(__file__).with_name("filter_bound.cc")
SCENARIO = "outdoor_patrol"
PERIODS = {"gnss": 10, "imu": 1, "magnetometer": 5, "barometer": 1}
# By the names and in the order of filter_bound.cc.
PARAMETERS = (
    "gyroscope_noise", "accelerometer_noise", "gyroscope_walk", "accelerometer_walk", "field_walk", "gyroscope_scale",
    "accelerometer_scale", "gyroscope_g_sensitivity", "height_std", "field_std", "field_scale", "sampling", "gate",
    "reset_after", "gravity",
)  # fmt: skip
# A tile of 16 worlds of 8 in single precision: covariances within this part of the largest variance of their rows.
TOLERANCE = 1e-3


class Filter:
    """The filter of some vehicles, on readings that do not change.

    Args:
        worlds: how many, side by side.
        vehicles: in each.
    """

    def __init__(self, worlds: int, vehicles: int):
        import jax
        import jax.numpy as jnp

        import qrsim
        from qrsim.engine import backend
        from qrsim.engine.layout import Packer, Shared

        sim = qrsim.load(_common.patrol(vehicles, SCENARIO), seed=3)
        sim.reset()
        fleet, state = sim.world.fleets[0], sim.state.fleets[0]
        self.estimator, names, dt = fleet.own_estimator, fleet.sensor_names, sim.world.time_step
        random = np.random.default_rng(5)
        self.readings = dict(zip(names, self._varied(state.readings, worlds, random), strict=True))
        self.memory = jax.tree.map(lambda leaf: np.stack([np.asarray(leaf)] * worlds), state.belief.memory)
        first = jax.tree.map(lambda leaf: leaf[0], (self.readings, self.memory))

        def call(estimator: Any, readings: Any, memory: Any, tick: Any) -> Any:
            """Return the filter's state after a tick."""
            fresh = {name: (tick + 1) % ticks == jnp.int32(0) for name, ticks in PERIODS.items()}
            return estimator.step(memory, readings, fresh, dt)[0]

        extent = backend.Extent(vehicles, np.dtype(np.float32), worlds)
        function = backend.Function("filter", call, text=None)
        self.program = backend.compile(
            function, Shared.of(self.estimator), Packer(first[0]), Packer(first[1]), extent, "llvm"
        )
        self.program.give(jax.tree.leaves(self.readings))
        self.state, self.tick, self.count = self.program.hold(self.memory), 0, worlds * vehicles

    @staticmethod
    def _varied(readings: Any, worlds: int, random: Any) -> Any:
        """Return readings (W, n) of vehicles that hover, with an error for each."""
        import jax

        def varied(leaf: Any) -> Any:
            """Return a number of a reading for each world; accuracies stay positive."""
            leaf = np.stack([np.asarray(leaf)] * worlds)
            if leaf.dtype.kind != "f":
                return leaf
            return (leaf + 0.01 * random.standard_normal(leaf.shape)).astype(leaf.dtype)

        return jax.tree.map(varied, readings)

    def advance(self, ticks: int) -> _common.Took:
        """Advance all vehicles, and return the time that it took."""
        wall, cpu = time.perf_counter(), time.process_time()
        self.state = self.program.run(self.state, self.tick, ticks)
        self.tick += ticks
        return _common.Took(time.perf_counter() - wall, time.process_time() - cpu)

    def rows(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return the present state as rows of numbers (k, W n), as filter_bound.cc prints them."""
        return _rows(self.state.get(lambda memory: memory))

    def given(self) -> str:
        """Return parameters, readings and first states as filter_bound.cc reads them."""
        fix, imu = self.readings["gnss"], self.readings["imu"]
        read = (
            imu.rates_body, imu.specific_force, fix.position_ned, fix.velocity_ned, fix.horizontal_accuracy,
            fix.vertical_accuracy, fix.speed_accuracy, fix.hdop, fix.vdop, self.readings["barometer"].height,
            self.readings["magnetometer"].field_body,
        )  # fmt: skip
        numbers = np.concatenate([_rows(read), _rows(self.memory)])
        lines = [" ".join(f"{float(getattr(self.estimator, name)):.9g}" for name in PARAMETERS)]
        return "\n".join([*lines, *(" ".join(f"{number:.9g}" for number in row) for row in numbers)])


def _rows(tree: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the leaves (W, n) or (W, k, n) of a tree as rows (k, W n)."""
    import jax

    parts = [np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(tree)]
    parts = [part[:, None] if part.ndim == 2 else part for part in parts]
    return np.concatenate([np.swapaxes(part, 0, 1).reshape(part.shape[1], -1) for part in parts])


Asked = Callable[..., list[list[str]]]


def check(asked: Asked, program: Path, ticks: int) -> float:
    """Compare the states of 32 vehicles after some ticks.

    Args:
        asked: runs a program, and returns the words of the lines that it prints.
        program: the compiled filter_bound.cc.
        ticks: flown by both, a multiple of the ten ticks that fixes are late by.

    Returns:
        The largest difference: relative, and for numbers below one absolute in their unit; of the covariance relative
        to the standard deviations of its two errors.

    Raises:
        SystemExit: it is above TOLERANCE.
    """
    ours = Filter(4, 8)
    theirs = np.array(asked(program, "check", ours.count, ticks, given=ours.given()), np.float64)
    begin = ours.rows()
    ours.advance(ticks)
    rows = ours.rows()
    if theirs.shape != rows.shape or np.allclose(begin, rows):
        raise SystemExit(f"filter_bound: {theirs.shape[0]} rows of numbers, and qrsim's filter has {rows.shape[0]}")
    off = np.abs(theirs - rows) / (1.0 + np.abs(rows))
    first, last, scale = _covariance(ours.memory, rows)
    off[first:last] = np.abs(theirs - rows)[first:last] / scale
    worst = float(np.max(off))
    if not worst <= TOLERANCE:
        raise SystemExit(f"filter_bound: row {np.argmax(off.max(axis=1))} differs from qrsim's by {worst:.2g}")
    return worst


def _covariance(memory: Any, rows: Any) -> tuple[int, int, Any]:
    """Return the first row of the covariance, that behind the last, and the products of standard deviations."""
    import jax

    sizes = [1 if leaf.ndim == 2 else leaf.shape[1] for leaf in jax.tree.leaves(memory)]
    number = int(np.argmax(sizes))
    first, half = sum(sizes[:number]), sizes[number]
    size = int(np.sqrt(2 * half))
    above, right = np.triu_indices(size)
    std = np.sqrt(rows[first : first + half][above == right])
    return first, first + half, std[above] * std[right]


class Timed(NamedTuple):
    """Times [s] of each measurement, and vehicles that are finite at the end."""

    walls: list[float]
    cpus: list[float]
    finite: int


def timed(
    asked: Asked, program: Path, threads: int, worlds: int, vehicles: int, ticks: int, repeats: int
) -> tuple[Timed, Timed]:
    """Return the times of the filter by hand and of this package, measured in turns."""
    ours = Filter(worlds, vehicles)
    given = ours.given()
    ours.advance(ticks)
    by_hand, own = [], []
    for _ in range(repeats):
        by_hand += [list(map(float, row)) for row in asked(program, "run", ours.count, ticks, 2, threads, given=given)]
        own += [ours.advance(ticks) for _ in range(2)]
    walls, cpus, finite = zip(*by_hand, strict=True)
    whole = int(np.isfinite(ours.rows()).all(axis=0).sum())
    return Timed(list(walls), list(cpus), int(finite[-1])), Timed(*map(list, zip(*own, strict=True)), whole)
