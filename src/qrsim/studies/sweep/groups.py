"""Conditions that differ in numbers only: one compiled program, and the places of those numbers in its World."""

from __future__ import annotations

import copy
import math
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jax.tree_util import PyTreeDef

from qrsim.core.arrays import NumpyArray
from qrsim.errors import ScenarioError, UsageError
from qrsim.files import Content
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.studies.sweep.axes import Axis, apply, in_ticks
from qrsim.world.state import World

# With this many ranges or more, their places are found together.
MANY = 4


@dataclass(frozen=True)
class Place:
    """Place of a scenario's number in the World.

    Attributes:
        path: of the number.
        step: what the World has it in multiples of: a time step [s], of times that it has in ticks; 0: nothing.
        in_degrees: whether the scenario has it in degrees, and the World in radians.
        parts: leaves of the World, by their number, and which of their elements are this number.
    """

    path: str
    step: float
    in_degrees: bool
    parts: tuple[tuple[int, NumpyArray], ...]

    def values(self, given: NumpyArray) -> NumpyArray:
        """Convert values of the scenario to the World's units (radians, ticks), as float64."""
        return np.array([_in_world(value, self.step, self.in_degrees) for value in given], np.float64)


@dataclass(frozen=True)
class Group:
    """Conditions of one structure.

    Attributes:
        content: of the scenario, the choices of this group made, every number at its lowest.
        world: of that.
        ticks: of an episode.
        time_step: of a tick [s].
        places: of the numbers that vary; None where worlds have to be loaded one by one.
        paths: of the numbers that vary.
    """

    content: Content
    world: World
    ticks: int
    time_step: float
    places: tuple[Place, ...] | None
    paths: tuple[str, ...]

    @property
    def vehicles(self) -> int:
        """Number of vehicles in all fleets of the group's world."""
        return sum(fleet.size for fleet in self.world.fleets)

    @cached_property
    def _leaves(self) -> tuple[list[NumpyArray], PyTreeDef]:
        """PyTree leaves of the group's world as arrays, and the tree's structure."""
        leaves, structure = jax.tree.flatten(self.world)
        return [np.asarray(leaf) for leaf in leaves], structure

    def varied(
        self, numbers: Mapping[str, NumpyArray]
    ) -> tuple[PyTreeDef, list[NumpyArray], list[NumpyArray], tuple[bool, ...]]:
        """Return (tree structure, shared leaves, varied leaves (W, ...), mask of varied leaves) of W worlds."""
        assert self.places is not None
        leaves, structure = self._leaves
        own: dict[int, NumpyArray] = {}
        for place in self.places:
            values = place.values(numbers[place.path])
            for leaf, elements in place.parts:
                if leaf not in own:
                    own[leaf] = np.repeat(leaves[leaf][None], len(values), axis=0)
                own[leaf][:, elements] = values.astype(own[leaf].dtype)[:, None]
        which = tuple(i in own for i in range(len(leaves)))
        fixed = [leaf for leaf, varies in zip(leaves, which, strict=True) if not varies]
        return structure, fixed, [own[i] for i in sorted(own)], which

    def loaded(self, numbers: Mapping[str, NumpyArray], precision: str) -> list[World]:
        """Return the World of each of W points, built by loading its scenario; ``numbers``: path -> values (W,)."""
        found: dict[Hashable, World] = {}
        rows = list(zip(*(numbers[path].tolist() for path in self.paths), strict=True))
        for row in rows:
            if row not in found:
                found[row] = self.scenario(dict(zip(self.paths, row, strict=True))).world(precision)
        return [found[row] for row in rows]

    def scenario(self, values: Mapping[str, object]) -> Scenario:
        """Return the scenario of the point at which the paths have the given values."""
        return scenario_at(self.content, values)


def scenario_at(content: Content, values: Mapping[str, object]) -> Scenario:
    """Load a scenario from its content with values set; ``values``: path -> value.

    Raises:
        UsageError, ScenarioError: it cannot be.
    """
    changed = copy.deepcopy(content)
    for path, value in values.items():
        apply(changed, path, value)
    return load_scenario(changed, quiet=True)


def faults(content: Content, values: Mapping[str, object]) -> list[str]:
    """Return the errors of a scenario with values set, one sentence each; [] if it is valid."""
    try:
        scenario_at(content, values)
    except ScenarioError as error:
        return error.problems
    except UsageError as error:
        text = str(error)
        return [text.partition(": ")[2] if text.startswith("--set ") else text]
    return []


def same_structure(one: Scenario, other: Scenario, precision: str) -> bool:
    """Return whether one compiled program can fly both scenarios."""
    if one.ticks != other.ticks:
        return False
    (mine, structure), (theirs, another) = (jax.tree.flatten(item.world(precision)) for item in (one, other))
    return repr(structure) == repr(another) and all(
        np.shape(a) == np.shape(b) and np.asarray(a).dtype == np.asarray(b).dtype
        for a, b in zip(mine, theirs, strict=True)
    )


def make_group(content: Content, choices: Mapping[str, object], numbers: Iterable[Axis], precision: str) -> Group:
    """Build the group of worlds with the same compiled program: structural ``choices`` made, ``numbers`` vary.

    Raises:
        ScenarioError: the scenario with these choices is wrong.
    """
    axes = tuple(numbers)
    base = copy.deepcopy(content)
    for path, value in choices.items():
        apply(base, path, value)
    lowest = {axis.path: axis.ends()[0] for axis in axes}
    content = copy.deepcopy(base)
    for path, value in lowest.items():
        apply(content, path, value)
    scenario = load_scenario(content, quiet=True)
    world = scenario.world(precision)
    paths = tuple(axis.path for axis in axes)
    group = Group(content, world, scenario.ticks, scenario.spec.time_step, None, paths)
    places = _places(base, axes, lowest, world, precision)
    if places is None:
        return group
    # A number may count only where another has some value: then the worlds at the far ends differ.
    found = replace(group, places=places)
    return found if all(_alike(found, base, values, precision) for values in _mixed(axes)) else group


def regrouped(group: Group, content: Content, axes: tuple[Axis, ...], precision: str) -> Group:
    """Return a group for another scenario; places of varied numbers in the World are reused if they fit.

    Raises:
        ScenarioError: the scenario is wrong.
    """
    base = copy.deepcopy(content)
    for axis in axes:
        apply(base, axis.path, axis.ends()[0])
    scenario = load_scenario(base, quiet=True)
    found = replace(group, content=base, world=scenario.world(precision), ticks=scenario.ticks)
    if found.places is not None and all(_alike(found, content, values, precision) for values in _mixed(axes)):
        return found
    return make_group(content, {}, axes, precision)


def _mixed(axes: tuple[Axis, ...]) -> list[Content]:
    """Return two points to test: all axes at their highest, and axes alternately at their lowest and highest."""
    highest = {axis.path: axis.ends()[1] for axis in axes}
    other = {axis.path: axis.ends()[i % 2] for i, axis in enumerate(axes)}
    return [highest, other]


def _alike(group: Group, base: Content, values: Mapping[str, object], precision: str) -> bool:
    """Return whether a world made by setting array elements equals, bit by bit, the one built from the scenario."""
    structure, fixed, own, which = group.varied({path: np.array([value], float) for path, value in values.items()})
    shares, owns = iter(fixed), iter(own)
    mine = [next(owns)[0] if varies else next(shares) for varies in which]
    world = scenario_at(base, values).world(precision)
    theirs, other = jax.tree.flatten(world)
    return repr(structure) == repr(other) and all(map(_same_bits, mine, theirs))


def _same_bits(one: object, other: object) -> bool:
    """Return whether two numbers or arrays have the same bytes."""
    return bool(np.asarray(one).tobytes() == np.asarray(other).tobytes())


def _places(
    base: Content, axes: tuple[Axis, ...], lowest: Mapping[str, object], world: World, precision: str
) -> tuple[Place, ...] | None:
    """Return the place of each axis's number in the World; None if one has no place, or two share one."""
    if len(axes) >= MANY and all(axis.values is None for axis in axes):
        together = _places_together(base, axes, lowest, world, precision)
        if together is not None:
            return together
    found = []
    taken: dict[int, NumpyArray] = {}
    for axis in axes:
        place = _place(base, axis, lowest, world, precision)
        if place is None:
            return None
        for leaf, elements in place.parts:
            if (taken.setdefault(leaf, np.zeros_like(elements)) & elements).any():
                return None
            taken[leaf] = taken[leaf] | elements
        found.append(place)
    return tuple(found)


def _places_together(
    base: Content, axes: tuple[Axis, ...], lowest: Mapping[str, object], world: World, precision: str
) -> tuple[Place, ...] | None:
    """Find the places of all axes' numbers in the World by changing all at once; None if one is ambiguous.

    Two further worlds are built, in which each number has another part of its range, so that a changed element of the
    World belongs to the one number that has its three values.
    """
    parts = np.arange(1, len(axes) + 1) / (len(axes) + 1.0)
    given = [[lowest[axis.path] for axis in axes]]
    for part in (0.5 * parts, 0.5 + 0.5 * parts[::-1]):
        chosen = zip(axes, part, strict=True)
        given.append(
            [float(in_ticks(axis.low + (axis.high - axis.low) * np.array(at), axis.step)) for axis, at in chosen]
        )
    paths = [axis.path for axis in axes]
    worlds = [world, *(scenario_at(base, dict(zip(paths, row, strict=True))).world(precision) for row in given[1:])]
    leaves = [[np.asarray(leaf) for leaf in jax.tree.leaves(item)] for item in worlds]
    # Of each number in each of its two forms the values in the three worlds.
    forms = [(i, step, degrees) for i, axis in enumerate(axes) for step, degrees in ((axis.step, False), (0.0, True))]
    values = np.array([[_in_world(row[i], step, degrees) for i, step, degrees in forms] for row in given], np.float64)
    found: dict[int, list[tuple[int, NumpyArray]]] = {}
    for number, versions in enumerate(zip(*leaves, strict=True)):
        differs = _differs(versions)
        if not differs.any():
            continue
        known = values.astype(versions[0].dtype)
        fits = np.all([versions[i][differs][:, None] == known[i] for i in range(3)], axis=0)
        if (fits.sum(axis=1) != 1).any():
            return None
        owner = fits.argmax(axis=1)
        for form in np.unique(owner):
            elements = np.zeros(differs.shape, bool)
            elements[differs] = owner == form
            found.setdefault(int(form), []).append((number, elements))
    if sorted(forms[form][0] for form in found) != list(range(len(axes))):
        return None
    each = sorted(found.items())
    return tuple(Place(paths[forms[form][0]], *forms[form][1:], tuple(parts)) for form, parts in each)


def _place(base: Content, axis: Axis, lowest: Mapping[str, object], world: World, precision: str) -> Place | None:
    """Find the elements of the World that an axis sets, by changing its value; None if it sets no element."""
    low, high = axis.ends()
    values = [low, _middle(axis), high]
    worlds = [world, *(scenario_at(base, {**lowest, axis.path: value}).world(precision) for value in values[1:])]
    leaves = [[np.asarray(leaf) for leaf in jax.tree.leaves(item)] for item in worlds]
    for step, in_degrees in ((axis.step, False), (0.0, True)):
        parts = _parts(leaves, [_in_world(value, step, in_degrees) for value in values])
        if parts:
            return Place(axis.path, step, in_degrees, parts)
    return None


def _in_world(value: Any, step: float, in_degrees: bool) -> Any:
    """Convert a scenario's value to its number in the World: ticks of ``step`` [s], radians if ``in_degrees``."""
    if in_degrees:
        return math.radians(value)
    return round(value / step) if step else value


def _middle(axis: Axis) -> object:
    """Return the middle of an axis's values."""
    if axis.values is None:
        return float(in_ticks(np.array(0.5 * (axis.low + axis.high)), axis.step))
    return sorted(axis.values)[len(axis.values) // 2]


def _parts(leaves: list[list[NumpyArray]], values: list[float]) -> tuple[tuple[int, NumpyArray], ...]:
    """Return (leaf index, mask) of elements that equal ``values[i]`` in world i of several; () if others differ too."""
    found = []
    for number, versions in enumerate(zip(*leaves, strict=True)):
        differs = _differs(versions)
        if not differs.any():
            continue
        for leaf, value in zip(versions, values, strict=True):
            if not (leaf[differs] == np.float64(value).astype(leaf.dtype)).all():
                return ()
        found.append((number, differs))
    return tuple(found)


def _differs(versions: tuple[NumpyArray, ...]) -> NumpyArray:
    """Return a mask of the elements that differ between several versions of an array; NaN equals NaN."""
    first, differs = versions[0], np.zeros(versions[0].shape, bool)
    for other in versions[1:]:
        differs = differs | ~((first == other) | ((first != first) & (other != other)))
    return differs
