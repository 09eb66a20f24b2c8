"""Rollouts of scenarios given by name, file or dict (see ``qrsim.simulation.rollout``)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from qrsim.errors import UsageError
from qrsim.models.site import Site
from qrsim.scenarios.reading import checked_overrides
from qrsim.scenarios.registry import made
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.simulation import rollout as rollouts
from qrsim.simulation.rollout import Rollout
from qrsim.world.state import State, World

Source = World | Scenario | str | Path | dict[str, Any]


def rollout(
    world: Source | Sequence[Source],
    policy: Any = None,
    *,
    ticks: int | None = None,
    worlds: int = 1,
    seed: int = 0,
    seeds: Sequence[int] | None = None,
    estimator: Any = None,
    policy_ticks: int = 1,
    metrics: Any = None,
    record: Callable[[State], Any] | None = None,
    record_every: int = 50,
    sink: Callable[[Any, int, Any], None] | None = None,
    progress: Callable[[int], None] | None = None,
    site: Site | None = None,
    precision: str = "float32",
    overrides: Iterable[str] = (),
) -> Rollout:
    """Fly many worlds from their start and return the metrics of each flight.

    >>> import qrsim
    >>> qrsim.rollout("hover", ticks=100, worlds=3).metrics["reason"].shape
    (3, 1)

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
            and an estimator may be named too, see docs/extending.md.
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
    """
    from qrsim.simulation.arguments import check_precision

    check_precision(precision)
    # A generator would be at its end after the first of several scenarios.
    overrides = checked_overrides(overrides)
    several = list(world) if isinstance(world, list | tuple) else [world]
    scenarios = [_scenario(source, overrides) for source in several]
    first = next((scenario for scenario in scenarios if scenario is not None), None)
    if ticks is None:
        if first is None:
            raise UsageError("ticks: how many is not said, and a World has no duration as a scenario has")
        ticks = first.ticks
    built: Any = [
        source if scenario is None else scenario.world(precision)
        for source, scenario in zip(several, scenarios, strict=True)
    ]
    return rollouts.rollout(
        built if isinstance(world, list | tuple) else built[0], policy, ticks=ticks, worlds=worlds, seed=seed,
        seeds=seeds, estimator=made("estimator", estimator), policy_ticks=policy_ticks, metrics=made("metric", metrics),
        record=record, record_every=record_every, sink=sink, progress=progress,
        site=site or (first.site if first else None),
    )  # fmt: skip


def _scenario(source: Any, overrides: Iterable[str]) -> Scenario | None:
    """Return the scenario of a source, None of a World."""
    if isinstance(source, World):
        if overrides:
            raise UsageError("overrides: they are of scenarios, and a World is given")
        return None
    if isinstance(source, Scenario):
        return source if not overrides else load_scenario(source.spec.model_dump(mode="json"), overrides)
    if isinstance(source, str | Path | dict):
        return load_scenario(source, overrides)
    raise UsageError(f"world: expected a scenario (its name, path or content) or a World, found {source!r}")
