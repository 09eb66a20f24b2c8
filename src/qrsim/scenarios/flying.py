"""Rollouts of scenarios given by name, file or dict (see ``qrsim.simulation.rollout``)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.models.site import Site
from qrsim.scenarios.reading import checked_overrides
from qrsim.scenarios.registry import made
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.simulation import rollout as rollouts
from qrsim.simulation.arguments import check_counts, check_precision
from qrsim.simulation.rollout import Rollout
from qrsim.world.state import State, World

if TYPE_CHECKING:
    from qrsim.simulation.simulation import Simulation

Source = World | Scenario | str | Path | Content


def rollout(
    world: Source | Sequence[Source],
    policy: object = None,
    *,
    ticks: int | None = None,
    worlds: int = 1,
    seed: int = 0,
    seeds: Sequence[int] | None = None,
    estimator: object = None,
    policy_ticks: int = 1,
    metrics: object = None,
    record: Callable[[State], Any] | None = None,
    record_every: int = 50,
    sink: Callable[[Any, int, Any], None] | None = None,
    progress: Callable[[int], None] | None = None,
    site: Site | None = None,
    precision: str = "float32",
    overrides: Iterable[str] = (),
) -> Rollout:
    """Fly many worlds in parallel from their starts, without recording runs; return the metrics of each flight.

    Args:
        world: a scenario by its name (``qrsim list``), the path of its YAML file, its content as a dict or a Scenario;
            a World; or a list with one of these for each world, which may differ in numbers only.
        policy: what commands the vehicles, see ``qrsim.interface.policies``; None: every fleet's own guidance.
        ticks: steps of every world; None: the duration of the scenario.
        worlds: how many, W; their randomness is (seed, 0), (seed, 1), ...
        seed: of all randomness.
        seeds: one for each world in place of ``seed`` and ``worlds``.
        estimator: what feeds the controllers in place of the sensors, see ``qrsim.interface.policies``.
        policy_ticks: the policy is asked at every so-many-th tick, and its command held in between.
        metrics: what sums up a flight: an object with ``init``, ``update`` and ``finish`` as in FlightMetrics; it
            and an estimator may be named too, see docs/howto/own_component.md.
        record: a function of a world's State that returns arrays to keep.
        record_every: ticks between two records, the first one at the start.
        sink: called with the numbers (B,) of some worlds, the tick, and what ``record`` returned for them, each leaf
            (B, ...): nothing is then held in memory.
        progress: called with the number of world-ticks done since the last call.
        site: origin of the local frame, for readings in latitude and longitude of policies outside the compiled loop;
            None: that of the scenario.
        precision: of scenarios, "float32" or "float64"; a World has its own.
        overrides: assignments to scenarios such as "world.wind.speed_20ft=7".

    Raises:
        UsageError: no such scenario, wrong numbers, worlds of different structure, a World without ticks, or a policy
            or estimator of the wrong kind, shape or value (vehicle, world and tick are named).
        ScenarioError: faults in a scenario, all of them listed.

    Examples:
        >>> import qrsim
        >>> qrsim.rollout("hover", ticks=100, worlds=3).metrics["reason"].shape
        (3, 1)
    """
    check_precision(precision)
    # A generator would be at its end after the first of several scenarios.
    overrides = checked_overrides(overrides)
    several = list(world) if isinstance(world, list | tuple) else [world]
    scenarios = [_scenario(source, overrides) for source in several]
    first = next((scenario for scenario in scenarios if scenario is not None), None)
    ticks = _ticks(ticks, first)
    built: Any = [
        source if scenario is None else scenario.world(precision)
        for source, scenario in zip(several, scenarios, strict=True)
    ]
    return rollouts.rollout(
        built if isinstance(world, list | tuple) else built[0],
        policy,
        ticks=ticks,
        worlds=worlds,
        seed=seed,
        seeds=seeds,
        estimator=made("estimator", estimator),
        policy_ticks=policy_ticks,
        metrics=made("metric", metrics),
        record=record,
        record_every=record_every,
        sink=sink,
        progress=progress,
        site=site or (first.site if first else None),
    )


@dataclass(frozen=True)
class Flight:
    """One flight of a world.

    Attributes:
        simulation: at the end of the flight, with ``truth``, ``valid`` and ``reasons``.
        ticks: (R,) recorded ticks, the start included.
        time: (R,) their times [s].
        position_ned: (R, n, 3) true positions [m] of all vehicles.
        velocity_ned: (R, n, 3) true velocities over ground [m/s].
    """

    simulation: Simulation
    ticks: Any
    time: Any
    position_ned: Any
    velocity_ned: Any

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Names of the n vehicles of the flight."""
        return self.simulation.vehicle_names


def play(
    world: Source,
    policies: Mapping[str, object],
    *,
    ticks: int | None = None,
    seed: int = 0,
    policy_ticks: int = 1,
    record_every: int = 1,
    precision: str = "float32",
    overrides: Iterable[str] = (),
) -> Flight:
    """Fly a world once, tick by tick, with a policy for each team; ``policies`` maps team to policy.

    The same dict is a policy of ``rollout``, which flies many worlds.

    Args:
        world: a scenario by its name, file, or content, a Scenario, or a World.
        policies: by the names of fleets or of single vehicles, see ``qrsim.interface.policies``. Each sees the readings
            of its own vehicles and commands these; who is in none flies by its own guidance.
        ticks: how many steps; None: the duration of the scenario.
        seed: of all randomness.
        policy_ticks: the policies are asked at every so-many-th tick.
        record_every: ticks between two records.
        precision: as in ``rollout``.
        overrides: as in ``rollout``.

    Raises:
        UsageError: no such scenario, fleet or vehicle, wrong numbers, or a policy of the wrong kind, shape or value.
        RunError: a policy failed.

    Examples:
        >>> import numpy as np
        >>> import qrsim
        >>> def climb(reading):
        ...     return qrsim.WaypointSetpoint.of(np.array([[0.0, 0.0, -30.0]]), 0.0)
        >>> qrsim.play("hover", {"pelicans": climb}, ticks=50).position_ned.shape
        (51, 1, 3)
    """
    from qrsim.simulation.pilot import Pilot
    from qrsim.simulation.simulation import Simulation

    if not isinstance(policies, Mapping):
        raise UsageError(f"policies: expected a dict with one for each team, found {policies!r}")
    check_precision(precision)
    scenario = _scenario(world, checked_overrides(overrides))
    ticks = _ticks(ticks, scenario)
    check_counts(ticks=ticks, record_every=record_every)
    built: Any = world if scenario is None else scenario.world(precision)
    named: dict[str, Any] = {} if scenario is None else {"name": scenario.name, "site": scenario.site}
    simulation = Simulation(built, seed=seed, **named)
    simulation.reset()
    pilot = Pilot(simulation, policies, None, policy_ticks)
    rows = [(0, simulation.truth.position_ned, simulation.truth.velocity_ned)]
    while simulation.tick < ticks:
        until = min(ticks, (simulation.tick // record_every + 1) * record_every)
        while simulation.tick < until:
            pilot.advance(until - simulation.tick)
        truth = simulation.truth
        rows.append((simulation.tick, truth.position_ned, truth.velocity_ned))
    counted, positions, velocities = (np.stack(column) for column in zip(*rows, strict=True))
    return Flight(simulation, counted, counted * built.time_step, positions, velocities)


def _ticks(ticks: int | None, scenario: Scenario | None) -> int:
    """Return how many ticks to fly: ``ticks`` if given, else the scenario's duration."""
    if ticks is not None:
        return ticks
    if scenario is None:
        raise UsageError("ticks: how many is not said, and a World has no duration as a scenario has")
    return scenario.ticks


def _scenario(source: object, overrides: Iterable[str]) -> Scenario | None:
    """Load the scenario that a source names, with overrides applied; None for a World."""
    if isinstance(source, World):
        if overrides:
            raise UsageError("overrides: they are of scenarios, and a World is given")
        return None
    if isinstance(source, Scenario):
        return source if not overrides else load_scenario(source.spec.model_dump(mode="json"), overrides)
    if isinstance(source, str | Path | dict):
        return load_scenario(source, overrides)
    raise UsageError(f"world: expected a scenario (its name, path or content) or a World, found {source!r}")
