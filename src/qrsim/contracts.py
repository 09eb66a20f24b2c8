"""The contracts of components and links of your own (docs/reference/contracts.md), in one place.

A component may name its contract as its base class, and need not. Methods marked abstract are required; everything else
has a default.

Examples:
    >>> from qrsim.contracts import Sensor, describe
    >>> describe("sensor")  # the members of a sensor, with shapes and units
"""

from __future__ import annotations

import inspect
import re
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.control import Estimate, Route, RouteState
from qrsim.control.contracts import Controller, Guidance
from qrsim.core.noise import Draw, Noise
from qrsim.core.tables import Table, Tabled
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3, rotation
from qrsim.errors import UsageError, did_you_mean
from qrsim.interface.readings import Reading
from qrsim.links.contracts import Order, Silence, Words
from qrsim.links.shared.plant import Plant
from qrsim.models.atmosphere.contracts import Gust, Turbulence, Updraft, Wind
from qrsim.models.gnss.contracts import RangeErrors
from qrsim.models.gnss.orbits import Ephemeris
from qrsim.models.scene.area import reason_code
from qrsim.models.scene.contracts import Area, Ground, Placement
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.vehicles.contracts import Around, Battery, Handling, Load, Outline, Pose, Vehicle
from qrsim.scenarios.conformity import CONTRACTS
from qrsim.tasks.agents import Axis
from qrsim.tasks.contracts import Task
from qrsim.world.state import State, World

__all__ = [
    "Area",
    "Around",
    "AttitudeTrig",
    "Axis",
    "Battery",
    "Controller",
    "Description",
    "Draw",
    "Ephemeris",
    "Estimate",
    "Estimator",
    "Euler",
    "Ground",
    "Guidance",
    "Gust",
    "Handling",
    "Load",
    "Metric",
    "Noise",
    "Order",
    "Outline",
    "Placement",
    "Plant",
    "Pose",
    "RangeErrors",
    "Route",
    "RouteState",
    "Sensor",
    "Silence",
    "State",
    "Task",
    "Turbulence",
    "Updraft",
    "Vec3",
    "Vehicle",
    "Wind",
    "Words",
    "World",
    "describe",
    "reason_code",
    "rotation",
]


class Estimator(Protocol):
    """Estimates the state of all n vehicles from their readings, in place of what their fleets have.

    ``qrsim.rollout(estimator=)`` and ``qrsim run --estimator`` take an object of this kind, made without arguments.
    """

    @abstractmethod
    def init(self, reading: Reading) -> Any:
        """Return the estimator's initial memory (any tree of arrays) from the first reading."""

    @abstractmethod
    def step(self, reading: Reading, memory: Any) -> tuple[Estimate, Any]:
        """Return the estimate (n,) at a tick (position [m], velocity [m/s], attitude [rad]), and the new memory."""


class Metric(Protocol):
    """Accumulates numbers of each flight, in flight.

    ``qrsim.rollout(metrics=)`` and ``own_metrics`` of a study take an object of this kind, made without arguments.
    """

    @abstractmethod
    def init(self, world: World, state: State) -> object:
        """Return the metric's accumulators at the start: a tree of arrays, each (n,) or ()."""

    @abstractmethod
    def update(self, memory: object, world: World, state: State, tick: Array) -> object:
        """Return the metric's accumulators updated by the state at a tick."""

    @abstractmethod
    def finish(self, memory: object, world: World, state: State) -> Mapping[str, npt.NDArray[np.generic]]:
        """Return metrics by name, each (W, n), from the accumulators and last states of W worlds, as NumPy arrays."""


# The contract of each kind of component, and of what links hand to the world that they share.
KINDS: dict[str, type] = {**CONTRACTS, "estimator": Estimator, "metric": Metric, "link": Plant}


class Description(Tabled):
    """The members of a contract: attributes and methods, the required ones, and the meaning of each.

    Attributes:
        kind: name of the kind, as ``qrsim.register`` takes it.
        contract: the class.
    """

    def __init__(self, kind: str, contract: type):
        self.kind, self.contract = kind, contract

    @property
    def required(self) -> tuple[str, ...]:
        """Names of the attributes and methods that have no default, so that a component must define them."""
        return tuple(name.partition("(")[0] for name, needed, _ in self._members() if needed)

    def _members(self) -> list[tuple[str, bool, str]]:
        """Return, for each attribute and method of the contract, its name, whether it is required, and its first
        paragraph."""
        contract, found = self.contract, []
        own = vars(contract)
        for name, words in _attributes(inspect.getdoc(contract) or "").items():
            found.append((name, name in inspect.get_annotations(contract) and name not in own, words))
        for name, member in own.items():
            if not name.startswith("_") and inspect.isfunction(member):
                arguments = list(inspect.signature(member).parameters.values())[1:]
                shown = ", ".join(
                    argument.name for argument in arguments if argument.kind is not argument.VAR_POSITIONAL
                )
                first = (inspect.getdoc(member) or "").partition("\n\n")[0]
                found.append((f"{name}({shown})", name in _abstract(contract), first))
        return found

    def _table(self) -> Table:
        """Return the contract as a table for display: a row for each attribute and method."""
        rows = [(name, "required" if needed else "default", words) for name, needed, words in self._members()]
        title = f"a {self.kind}: {self.contract.__module__}.{self.contract.__qualname__}"
        return Table(title, ("name", "", "meaning"), rows, widest=400)


def describe(kind: str) -> Description:
    """Describe what a kind of component ("sensor", "wind", ...) has to implement: attributes, methods, shapes and
    units.

    Args:
        kind: one of ``KINDS``, such as "sensor".

    Raises:
        UsageError: no kind is called so.
    """
    if kind not in KINDS:
        raise UsageError(f"contracts: no kind of component is called {kind!r:.60}{did_you_mean(str(kind), KINDS)}")
    return Description(kind, KINDS[kind])


def _abstract(contract: type) -> frozenset[str]:
    """Return the names of the methods that a contract (a Protocol class) leaves abstract, so that they are required."""
    names: frozenset[str] = vars(contract).get("__abstractmethods__", frozenset())
    return names


def _attributes(doc: str) -> dict[str, str]:
    """Return attribute -> description, parsed from the "Attributes" section of a docstring."""
    _, _, section = doc.partition("\nAttributes:\n")
    found: dict[str, str] = {}
    names: list[str] = []
    for line in section.splitlines():
        match = re.match(r"    ([a-z_]+(?:, [a-z_]+)*): (.*)", line)
        if match:
            names = match[1].split(", ")
            found |= dict.fromkeys(names, match[2])
        elif line.startswith("        "):
            found |= {name: f"{found[name]} {line.strip()}" for name in names}
    return found
