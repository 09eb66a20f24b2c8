"""Many worlds at once: compiled, cut into blocks that fit in memory, over all devices.

A world of a rollout flies like a Simulation with its seed and number. Its noise does not depend on the number of
worlds, and is bit-identical however the worlds are cut into blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.sameness import sameness
from qrsim.core.structure import kinds
from qrsim.core.tables import Table, Tabled, number_text
from qrsim.engine.settings import device_mesh, use_compilation_cache
from qrsim.errors import UsageError, did_you_mean, shortened
from qrsim.interface.metrics import FLIGHT_METRICS
from qrsim.interface.policies import user_function
from qrsim.models.scene.area import reason_text
from qrsim.models.site import Site
from qrsim.simulation.arguments import LARGEST_TICK, check_counts
from qrsim.simulation.block_parts import Setup
from qrsim.simulation.blocks import Engine, Schedule
from qrsim.world.state import State, World

# Vehicles of a block on one device: their states and the noise of a tick then stay in a core's own cache.
VEHICLES_PER_BLOCK = 4096
# Limit for the states of a block; a tick needs about COPIES of them.
MEMORY_BYTES = 512 * 2**20
COPIES = 4
LARGEST_SEED = 2**63


# Units of metrics, by the ends of their names.
_UNITS = {"_m_s": "m/s", "_m": "m", "_s": "s", "_position_ned": "m", "position_ned": "m"}


@dataclass
class Rollout(Tabled):
    """Results of W worlds of n vehicles each.

    Attributes:
        metrics: by name, each (W, n) or (W, n, 3); see ``qrsim.interface.metrics.FlightMetrics``.
        recorded: what ``record`` returned, each leaf (W, R, ...); None where nothing was, or all went to a sink.
        record_ticks: (R,) ticks of what was recorded.
        seeds, numbers: (W,) seed of each world and its number in that seed: ``Simulation(world, seed=, number=)``
            flies it again.
        vehicles: names, in the order of the arrays.
    """

    metrics: dict[str, NumpyArray]
    recorded: Any
    record_ticks: NumpyArray
    seeds: NumpyArray
    numbers: NumpyArray
    vehicles: tuple[str, ...]

    __repr__ = Tabled.__repr__

    def _table(self) -> Table:
        """Return the metrics as a table for display: least, median and greatest value over the worlds."""
        count = len(self.seeds)
        recorded = f"; recorded at {len(self.record_ticks)} ticks" if len(self.record_ticks) else ""
        vehicles = shortened(", ".join(self.vehicles))
        title = f"rollout of {count} world{'s' * (count != 1)} of {len(self.vehicles)}: {vehicles}{recorded}"
        rows = [_metric_row(name, np.asarray(values)) for name, values in self.metrics.items()]
        return Table(title, ("metric", "unit", "shape", "least", "median", "greatest"), rows)

    def _ipython_key_completions_(self) -> list[str]:
        """Return the metrics' names, which IPython offers as keys."""
        return list(self.metrics)

    def __iter__(self) -> Iterator[str]:
        """Return the names of the metrics, one after the other."""
        return iter(self.metrics)

    def __getitem__(self, name: str) -> NumpyArray:
        """Return a metric, (W, n).

        Raises:
            UsageError: no metric has this name.
        """
        if not isinstance(name, str):
            raise UsageError(
                f"a rollout has metrics by name, each (W, n), and no number {name!r:.40}; such as flown['flown_s']"
            )
        if name not in self.metrics:
            raise UsageError(f"no metric is called '{name}'{did_you_mean(name, self.metrics)}")
        return self.metrics[name]

    def reasons(self, world: int) -> list[str]:
        """Return, for each vehicle of world number ``world``, why it stopped; "" if it still flies.

        Args:
            world: number of the world, from 0.

        Raises:
            UsageError: there is no such world.
        """
        count = len(self.metrics["reason"])
        if isinstance(world, bool) or not isinstance(world, int | np.integer) or not 0 <= world < count:
            raise UsageError(f"world: {world!r:.80} is none of this rollout; allowed: an integer from 0 to {count - 1}")
        codes, values = self.metrics["reason"][world], self.metrics["reason_value"][world]
        return [reason_text(int(code), float(value)) for code, value in zip(codes, values, strict=True)]


def _metric_row(name: str, values: NumpyArray) -> tuple[str, ...]:
    """Return a metric's name, unit, shape, and least, median and greatest value as texts; the values only for (W,
    n)."""
    unit = next((unit for end, unit in _UNITS.items() if name.endswith(end)), "")
    numbers = values[np.isfinite(values)] if values.ndim == 2 and values.dtype.kind in "fiub" else values[:0]
    found = (numbers.min(), np.median(numbers), numbers.max()) if numbers.size else (None,) * 3
    return name, unit, str(values.shape), *map(number_text, found)


def rollout(
    world: World | Sequence[World],
    policy: object = None,
    *,
    ticks: int,
    worlds: int = 1,
    seed: int = 0,
    seeds: Sequence[int] | None = None,
    estimator: object = None,
    policy_ticks: int = 1,
    metrics: object = None,
    record: Callable[[State], Any] | None = None,
    record_every: int = 50,
    sink: Callable[[NumpyArray, int, Any], None] | None = None,
    progress: Callable[[int], None] | None = None,
    site: Site | None = None,
) -> Rollout:
    """Fly many worlds from their start and return the metrics of each flight.

    What ``qrsim.rollout`` does with scenarios once they are Worlds; its docstring explains every argument.

    Args:
        world: the parameters of all worlds, or a list with those of each, which may differ in numbers only.
        ticks: steps of every world.

    Raises:
        UsageError: wrong numbers, worlds of different structure, or a policy or estimator of the wrong kind, shape or
            value (vehicle, world and tick are named).
    """
    use_compilation_cache()
    several = [world] if isinstance(world, World) else list(world)
    check_counts(ticks=ticks, worlds=worlds, policy_ticks=policy_ticks, record_every=record_every)
    if ticks > LARGEST_TICK:
        raise UsageError(f"ticks: {ticks} would pass the last tick, {LARGEST_TICK}")
    if sink is not None and record is None:
        raise UsageError("sink: there is nothing to hand to it without record")
    which = _seeds_and_numbers(several, isinstance(world, World), worlds, seed, seeds)
    dtype = np.dtype(several[0].fleets[0].start.position_ned.x.dtype)
    with jax.enable_x64(dtype == np.float64):
        setup, fixed, varied = setup_of(several, policy, estimator, metrics, policy_ticks, site)
        schedule = Schedule(ticks, record_every if record else 0)
        engine = Engine(setup, several[0], fixed, varied, schedule, record, sink, progress or (lambda done: None))
        blocks = [engine.fly(rows, *which) for rows in _blocks(engine, len(which[0]))]
    results = {name: np.concatenate([block[0][name] for block in blocks]) for name in blocks[0][0]}
    history = None
    if record is not None and sink is None:
        history = jax.tree.map(lambda *parts: np.concatenate(parts), *(block[1] for block in blocks))
    names = tuple(name for fleet in several[0].fleets for name in fleet.vehicle_names)
    return Rollout(results, history, np.array(schedule.records, np.int64), *which, names)


def setup_of(
    several: Sequence[World],
    policy: object = None,
    estimator: object = None,
    metrics: object = None,
    policy_ticks: int = 1,
    site: Site | None = None,
) -> tuple[Setup, list[Any], list[Any]]:
    """Return the setup of a rollout of W worlds, the arrays that are equal in all worlds, and those that vary (W, ...).

    The arguments are those of ``rollout``; ``several`` lists the worlds.
    """
    structure, fixed, varied, which_varied = _stack(list(several))
    metrics = FLIGHT_METRICS if metrics is None else metrics
    setup = Setup(
        policy=user_function("policy", policy),
        estimator=user_function("estimator", estimator),
        metrics=metrics,
        measured=sameness(metrics),
        policy_ticks=policy_ticks,
        site=site or Site(),
        structure=structure,
        types=repr(structure),
        varied=which_varied,
        mesh=device_mesh(),
        kinds=tuple(kinds(structure)),
    )
    return setup, fixed, varied


def _seeds_and_numbers(
    several: list[World], alike: bool, worlds: int, seed: object, seeds: Sequence[int] | None
) -> tuple[NumpyArray, NumpyArray]:
    """Return the seed (W,) and the number (W,) of each world; raises UsageError for wrong ones. ``alike``: one world is
    repeated."""
    if not several:
        raise UsageError("world: an empty list has no world to fly")
    if seeds is not None and not hasattr(seeds, "__iter__"):
        raise UsageError(f"seeds: expected one for each world, such as range(10), found {seeds!r:.100}")
    given = [seed] if seeds is None else list(seeds)
    for value in given:
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 0 <= value < LARGEST_SEED:
            raise UsageError(f"seed: {value!r} is not an integer from 0 to 2**63 - 1")
    if not given:
        raise UsageError("seeds: an empty list has no world to fly")
    count = len(given) if seeds is not None else worlds if alike else len(several)
    if not alike and count != len(several):
        raise UsageError(f"seeds: {count} for {len(several)} worlds; expected one for each")
    if worlds not in (1, count):
        raise UsageError(f"worlds: {worlds}, but a list of {count} was given")
    if seeds is not None:
        return np.array(given, np.int64), np.zeros(count, np.int64)
    return np.full(count, seed, np.int64), np.arange(count)


def _stack(several: list[World]) -> tuple[Any, list[Any], list[Any], tuple[bool, ...]]:
    """Split worlds into their structure, shared arrays, varying arrays (W, ...), and which arrays vary; raises
    UsageError."""
    flat: list[tuple[list[Any], Any]] = [jax.tree.flatten(world) for world in several]
    structure = flat[0][1]
    types = tuple(kinds(structure))
    for i, (_, other) in enumerate(flat[1:], 1):
        # Types are compared by identity too: two files may define classes of the same name.
        alike = other == structure and tuple(kinds(other)) == types
        different = "" if alike else "types, names, sensors or settings"
        if different or (different := _other_arrays(several[0], several[i])):
            raise UsageError(
                f"world: number {i} differs from number 0 in more than numbers: {different}; fly those that are alike "
                "together"
            )
    columns = list(zip(*(part for part, _ in flat), strict=True))
    which = tuple(
        any(not np.array_equal(column[0], other, equal_nan=True) for other in column[1:]) for column in columns
    )
    fixed = [_on_host(column[0]) for column, varies in zip(columns, which, strict=True) if not varies]
    varied = [np.stack(column) for column, varies in zip(columns, which, strict=True) if varies]
    return structure, fixed, varied, which


def _on_host(leaf: object) -> NumpyArray:
    """Return an array as NumPy, in a dtype that JAX supports, without a compilation by JAX."""
    array = np.asarray(leaf)
    return np.asarray(array, jax.dtypes.canonicalize_dtype(array.dtype))


def _other_arrays(one: World, other: World) -> str:
    """Return a text on the first array in which two worlds differ in shape or dtype; "" if none does."""
    (named, _), others = jax.tree_util.tree_flatten_with_path(one), jax.tree.leaves(other)
    for (path, mine), theirs in zip(named, others, strict=True):
        sorts = [f"{np.asarray(leaf).dtype} {np.shape(leaf)}" for leaf in (mine, theirs)]
        if sorts[0] != sorts[1]:
            return f"{jax.tree_util.keystr(path).lstrip('.')} is {sorts[1]}, not {sorts[0]}"
    return ""


def _blocks(engine: Engine, count: int) -> Iterator[NumpyArray]:
    """Yield the numbers of the worlds in each block, all of one length; the last block repeats its last world."""
    size, devices = len(engine.names), engine.devices
    in_memory = MEMORY_BYTES // (COPIES * engine.bytes_per_world() * devices)
    most = max(1, min(VEHICLES_PER_BLOCK // size, in_memory)) * devices
    blocks = -(-count // most)
    length = -(-count // (blocks * devices)) * devices
    for first in range(0, count, length):
        yield np.minimum(np.arange(first, first + length), count - 1)
