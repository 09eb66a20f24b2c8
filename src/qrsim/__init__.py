"""qrsim: a multi-UAV outdoor simulator.

Examples:
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
    from qrsim.control import (
        AttitudeHeightSetpoint,
        AttitudeSetpoint,
        Estimate,
        PathSetpoint,
        TrackSetpoint,
        VelocityHeightSetpoint,
        VelocitySetpoint,
        WaypointSetpoint,
    )
    from qrsim.core.tree import parameter, quantity, record, setting
    from qrsim.core.vectors import Euler, Vec3
    from qrsim.engine.settings import configure
    from qrsim.interface.messages import Say
    from qrsim.models.sensors.earth_field import compass_heading
    from qrsim.models.vehicles.multirotor import AttitudeCommand, MotorCommand, RateCommand
    from qrsim.models.vehicles.multirotor.own import own_multirotor
    from qrsim.models.vehicles.quadrotor import Command
    from qrsim.runs import Run, open_run
    from qrsim.runs.recorder import fly
    from qrsim.scenarios.flying import Flight, play, rollout
    from qrsim.scenarios.making import make_scenario, make_world
    from qrsim.scenarios.registry import register
    from qrsim.scenarios.scenario import Scenario, load_scenario
    from qrsim.simulation.rollout import Rollout
    from qrsim.simulation.simulation import Simulation
    from qrsim.view.notebook import show
    from qrsim.world.state import State, World

__version__ = metadata.version("qrsim")

# Imported on first use, so that a command pays only for what it needs.
_LAZY = {
    "AttitudeHeightSetpoint": "qrsim.control",
    "AttitudeSetpoint": "qrsim.control",
    "AttitudeCommand": "qrsim.models.vehicles.multirotor",
    "Command": "qrsim.models.vehicles.quadrotor",
    "Estimate": "qrsim.control",
    "Euler": "qrsim.core.vectors",
    "Flight": "qrsim.scenarios.flying",
    "PathSetpoint": "qrsim.control",
    "MotorCommand": "qrsim.models.vehicles.multirotor",
    "RateCommand": "qrsim.models.vehicles.multirotor",
    "Rollout": "qrsim.simulation.rollout",
    "Run": "qrsim.runs",
    "Scenario": "qrsim.scenarios.scenario",
    "Simulation": "qrsim.simulation.simulation",
    "State": "qrsim.world.state",
    "TrackSetpoint": "qrsim.control",
    "VelocityHeightSetpoint": "qrsim.control",
    "VelocitySetpoint": "qrsim.control",
    "WaypointSetpoint": "qrsim.control",
    "Vec3": "qrsim.core.vectors",
    "World": "qrsim.world.state",
    "compass_heading": "qrsim.models.sensors.earth_field",
    "configure": "qrsim.engine.settings",
    "fly": "qrsim.runs.recorder",
    "load_scenario": "qrsim.scenarios.scenario",
    "make_scenario": "qrsim.scenarios.making",
    "make_world": "qrsim.scenarios.making",
    "open_run": "qrsim.runs",
    "own_multirotor": "qrsim.models.vehicles.multirotor.own",
    "parameter": "qrsim.core.tree",
    "play": "qrsim.scenarios.flying",
    "quantity": "qrsim.core.tree",
    "record": "qrsim.core.tree",
    "register": "qrsim.scenarios.registry",
    "rollout": "qrsim.scenarios.flying",
    "Say": "qrsim.interface.messages",
    "setting": "qrsim.core.tree",
    "show": "qrsim.view.notebook",
}

# Rooms and modules that are used as a library, imported on first use too.
_ROOMS = {
    "contracts": "qrsim.contracts",
    "discover": "qrsim.studies.discover",
    "envs": "qrsim.envs",
    "geoid": "qrsim.models.geoid",
    "identify": "qrsim.studies.identify",
    "slam": "qrsim.studies.slam",
    "sweep": "qrsim.studies.sweep",
    "validate": "qrsim.studies.validate",
}

__all__ = [
    "AttitudeCommand",
    "AttitudeHeightSetpoint",
    "AttitudeSetpoint",
    "Command",
    "Estimate",
    "Euler",
    "Flight",
    "MotorCommand",
    "PathSetpoint",
    "RateCommand",
    "Rollout",
    "Run",
    "Say",
    "Scenario",
    "Simulation",
    "State",
    "TrackSetpoint",
    "Vec3",
    "VelocityHeightSetpoint",
    "VelocitySetpoint",
    "WaypointSetpoint",
    "World",
    "__version__",
    "compass_heading",
    "configure",
    "fly",
    "load",
    "load_scenario",
    "make_scenario",
    "make_world",
    "open_run",
    "own_multirotor",
    "parameter",
    "play",
    "quantity",
    "record",
    "register",
    "rollout",
    "setting",
    "show",
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
    from qrsim.simulation.arguments import check_precision
    from qrsim.simulation.simulation import Simulation

    check_precision(precision)
    scenario = load_scenario(source, overrides)
    return Simulation(scenario.world(precision), seed=seed, name=scenario.name, site=scenario.site)


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        import importlib

        return getattr(importlib.import_module(_LAZY[name]), name)
    if name in _ROOMS:
        import importlib

        return importlib.import_module(_ROOMS[name])
    from qrsim.errors import did_you_mean, nearest

    # Python itself asks for names such as __path__; of these nobody has mistyped one.
    known = [*__all__, *_ROOMS]
    hint = did_you_mean(name, known) if nearest(name, known) and not name.startswith("_") else ""
    raise AttributeError(f"module 'qrsim' has no attribute '{name}'{hint}")


def __dir__() -> list[str]:
    """Return the public names, for completion."""
    return [*__all__, *_ROOMS, *(name for name in globals() if name.startswith("__") and name not in __all__)]
