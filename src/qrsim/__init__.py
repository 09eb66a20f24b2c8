"""qrsim: a multi-UAV outdoor simulator.

>>> import qrsim
>>> sim = qrsim.load("outdoor_patrol", seed=1)
>>> reading = sim.reset()
>>> reading = sim.step(ticks=50)
>>> sim.truth.position_ned.shape
(5, 3)
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from qrsim.control import WaypointSetpoint
    from qrsim.logs import Run, open_run
    from qrsim.models.vehicles.quadrotor import Command
    from qrsim.scenarios.scenario import Scenario, load_scenario
    from qrsim.simulation import Simulation
    from qrsim.world import State, World

__version__ = metadata.version("qrsim")

# Imported on first use, so that a command pays only for what it needs.
_LAZY = {
    "Command": "qrsim.models.vehicles.quadrotor",
    "Run": "qrsim.logs",
    "Scenario": "qrsim.scenarios.scenario",
    "Simulation": "qrsim.simulation",
    "State": "qrsim.world",
    "WaypointSetpoint": "qrsim.control",
    "World": "qrsim.world",
    "load_scenario": "qrsim.scenarios.scenario",
    "open_run": "qrsim.logs",
}

__all__ = [
    "Command",
    "Run",
    "Scenario",
    "Simulation",
    "State",
    "WaypointSetpoint",
    "World",
    "__version__",
    "load",
    "load_scenario",
    "open_run",
]


def load(
    source: str | Path | dict[str, Any],
    *,
    seed: int = 0,
    precision: str = "float32",
    overrides: Iterable[str] = (),
) -> Simulation:
    """Return a simulation of a scenario, ready for ``reset``.

    Args:
        source: a built-in name (``qrsim list``), the path of a YAML file, or the content as a dict.
        seed: of all randomness.
        precision: "float32", or "float64" for accuracy.
        overrides: assignments such as "world.wind.speed_20ft=7".

    Raises:
        UsageError: unknown scenario, precision or seed.
        ScenarioError: faults in the scenario, all of them listed.
    """
    from qrsim.scenarios.scenario import load_scenario
    from qrsim.simulation import Simulation, check_precision

    check_precision(precision)
    scenario = load_scenario(source, overrides)
    return Simulation(scenario.world(precision), seed=seed, name=scenario.name, site=scenario.site)


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        import importlib

        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'qrsim' has no attribute '{name}'")
