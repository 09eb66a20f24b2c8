"""Learned policies: a neural network in a file, as ``qrsim train`` writes it, flown with NumPy alone.

A file is a NumPy archive: weights, the scaling of inputs and actions, and a text in JSON with the task that it was
trained on. A policy sees what the agents of its task observe, never the truth.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.control.setpoints import library
from qrsim.core.arrays import Floats
from qrsim.errors import UsageError, readable
from qrsim.files.numpy_file import read_arrays
from qrsim.files.user_files import read_bytes
from qrsim.tasks.agents import still
from qrsim.tasks.baselines.one_of_several import OneOfSeveral
from qrsim.tasks.play import Play
from qrsim.tasks.teams import side_of_fleet

SUFFIX = ".npz"
FORMAT = "qrsim policy 1"
# Largest file [bytes] and array of one.
LARGEST, MOST_NUMBERS = 64 * 2**20, 4_000_000
# Inputs are limited to this many standard deviations.
LIMIT = 10.0
# An integral is limited to this [m s].
MOST_SUM = 20.0
# Offsets shorter than this have no direction [m].
SHORTEST = 1e-3
META = "meta"


@dataclass(frozen=True)
class View:
    """How a policy sees its task: the selected observations, in its own heading, next to its last action.

    Attributes:
        task: name of the scenario.
        version: of the task.
        seconds: time between two decisions [s].
        observed: names of the O numbers of an observation.
        acts: names of the A numbers of an action.
        kept: which of the observed numbers are inputs; O + i is the integral of ``summed[i]``.
        pairs: north and east of each horizontal vector among them, rotated into the heading.
        yaw: where the heading is in an observation; None: nothing is rotated.
        flown: which numbers of an action the policy gives; the others have the value of ``centre``.
        centre: (A,) action of a network that returns zeros.
        reach: (A,) change of the action for each unit that the network returns.
        ahead: north and east of the observed offset along which the inputs are turned; None: the heading, ``yaw``.
        turned: which of the network's outputs are ahead and to the right of ``ahead``, and commanded north and east.
        summed: which of the observed numbers are integrated over time, for inputs; the policy remembers the integrals.
        fleet: name of the fleet that it flies, in a task with agents of several; None: the only one.
    """

    task: str
    version: int
    seconds: float
    observed: tuple[str, ...]
    acts: tuple[str, ...]
    kept: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]
    yaw: int | None
    flown: tuple[int, ...]
    centre: tuple[float, ...]
    reach: tuple[float, ...]
    ahead: tuple[int, int] | None = None
    turned: tuple[int, int] | None = None
    summed: tuple[int, ...] = ()
    fleet: str | None = None

    @property
    def remembered(self) -> int:
        """Size K of what a policy remembers between two decisions: its last outputs, and integrals of observations."""
        return len(self.flown) + len(self.summed)

    @property
    def inputs(self) -> int:
        """Number of inputs of the network (F)."""
        return len(self.kept) + len(self.flown)

    def features(self, seen: Any, last: Any) -> Any:
        """Return the network's inputs (N, F) for observations (N, O) and remembered values (N, K); NumPy or JAX."""
        lib = library(seen)
        outputs, sums = last[:, : len(self.flown)], last[:, len(self.flown) :]
        columns = [lib.asarray(seen[:, number], np.float32) for number in range(len(self.observed))] + list(sums.T)
        turn = self._turn(columns)
        if turn is not None:
            cos, sin = turn
            for north, east in self.pairs:
                ahead = cos * columns[north] + sin * columns[east]
                columns[north], columns[east] = ahead, cos * columns[east] - sin * columns[north]
        return lib.stack([*(columns[number] for number in self.kept), *outputs.T], axis=-1)

    def remember(self, output: Any, seen: Any, last: Any) -> Any:
        """Return the values (N, K) to remember after a decision: outputs (N, len(flown)), sums of ``seen`` (N, O)."""
        outputs = output.clip(-LIMIT, LIMIT)
        if not self.summed:
            return outputs
        lib = library(seen)
        sums = [
            last[:, len(self.flown) + i] + np.float32(self.seconds) * lib.asarray(seen[:, number], np.float32)
            for i, number in enumerate(self.summed)
        ]
        return lib.concatenate([outputs, lib.stack(sums, axis=-1).clip(-MOST_SUM, MOST_SUM)], axis=-1)

    def action(self, output: Any, seen: Any = None) -> Any:
        """Convert the network's outputs (N, len(flown)) to actions (N, A) in [-1, 1]; NumPy or JAX.

        Args:
            output: of the network.
            seen: (N, O) the observations of the decision; only a view with ``turned`` needs them.
        """
        lib = library(output)
        if self.turned is not None:
            output = self._turned_back(output, [lib.asarray(seen[:, i], np.float32) for i in range(len(self.observed))])
        columns = []
        for number, (centre, reach) in enumerate(zip(self.centre, self.reach, strict=True)):
            neutral = lib.full_like(output[:, 0], np.float32(centre))
            moved = number in self.flown
            columns.append(neutral + np.float32(reach) * output[:, self.flown.index(number)] if moved else neutral)
        return lib.stack(columns, axis=-1).clip(-1.0, 1.0)

    def output(self, action: Floats, seen: Floats) -> Floats:
        """Return the outputs (N, len(flown)) of a network that commands actions (N, A) at observations (N, O)."""
        given = [(action[:, i] - np.float32(self.centre[i])) / np.float32(self.reach[i]) for i in self.flown]
        if self.turned is not None:
            cos, sin = self._turn([np.asarray(seen[:, i], np.float32) for i in range(len(self.observed))])
            first, second = self.turned
            north, east = given[first], given[second]
            given[first], given[second] = cos * north + sin * east, cos * east - sin * north
        return np.stack(given, axis=-1).astype(np.float32)

    def _turn(self, columns: Any) -> Any:
        """Return cosine and sine (N,) of the heading by which inputs are rotated; None if they are not rotated."""
        if self.ahead is not None:
            lib = library(columns[0])
            north, east = (columns[number] for number in self.ahead)
            length = lib.maximum(lib.sqrt(north * north + east * east), np.float32(SHORTEST))
            return north / length, east / length
        if self.yaw is not None:
            lib = library(columns[0])
            return lib.cos(columns[self.yaw]), lib.sin(columns[self.yaw])
        return None

    def _turned_back(self, output: Any, columns: Any) -> Any:
        """Return the network's outputs (N, len(flown)), the pair ``turned`` rotated from ``ahead`` to north, east."""
        cos, sin = self._turn(columns)
        parts: list[Any] = list(output.T)
        first, second = self.turned or (0, 0)
        ahead, right = parts[first], parts[second]
        parts[first], parts[second] = cos * ahead - sin * right, sin * ahead + cos * right
        return library(output).stack(parts, axis=-1)


@dataclass(frozen=True)
class Scaling:
    """Mean and standard deviation of the inputs, (F,) each."""

    mean: Floats
    deviation: Floats

    def scaled(self, features: Any) -> Any:
        """Normalise the network's inputs (N, F) to mean 0 and deviation 1, limited to +-``LIMIT``; NumPy or JAX."""
        return ((features - self.mean[None]) / self.deviation[None]).clip(-LIMIT, LIMIT)


Layers = Sequence[tuple[Floats, Floats]]


def forward(layers: Layers, inputs: Any) -> Any:
    """Return the outputs (N, K) of a network of layers with tanh between them, for inputs (N, F); NumPy or JAX."""
    lib = library(inputs)
    for weights, offset in layers[:-1]:
        inputs = lib.tanh(inputs @ weights + offset[None])
    weights, offset = layers[-1]
    return inputs @ weights + offset[None]


@dataclass(frozen=True)
class PolicyFile:
    """A learned policy.

    Attributes:
        view: how it sees its task.
        scaling: of its inputs.
        layers: of its network, weights and offsets.
        facts: how it was trained: seed, steps, overrides.
        name: of the file, for messages.
    """

    view: View
    scaling: Scaling
    layers: tuple[tuple[Floats, Floats], ...]
    facts: dict[str, Any]
    name: str = "policy"

    def content(self) -> bytes:
        """Return the content of the policy's file as bytes."""
        view = asdict(self.view)
        # Versions without integrals or fleets read the file too.
        if not self.view.summed:
            del view["summed"]
        if self.view.fleet is None:
            del view["fleet"]
        meta = json.dumps({"format": FORMAT, "view": view, "facts": self.facts}, sort_keys=True)
        arrays: dict[str, Any] = {META: np.frombuffer(meta.encode(), np.uint8)}
        arrays |= {"mean": self.scaling.mean, "deviation": self.scaling.deviation}
        for number, (weights, offset) in enumerate(self.layers):
            arrays |= {f"weights_{number}": weights, f"offset_{number}": offset}
        file = io.BytesIO()
        np.savez(file, **arrays)
        return file.getvalue()

    def maker(self, play: Play, name: str, version: int) -> Any:
        """Return a function (play, seed) -> policy for an episode; raise UsageError if the policy is of another task.

        Args:
            play: the task and its world.
            name: of its scenario.
            version: of its tasks.

        Raises:
            UsageError: it is another task or version, or its agents observe or command something else.
        """
        view = self.view
        if (view.task, view.version) != (name, version):
            trained = f"it was trained on {view.task} (version {view.version})"
            raise UsageError(f"policy {self.name}: {trained}; this task is {name} (version {version})")
        fleets = [side.fleet for side in play.sides]
        if view.fleet not in (fleets if len(fleets) > 1 else (None, *fleets)):
            flies = "agents of one fleet" if view.fleet is None else f"fleet '{view.fleet}'"
            raise UsageError(f"policy {self.name}: it flies {flies}; agents of this task are {', '.join(fleets)}")
        self.check(play, view.fleet)
        if len(fleets) == 1:
            return lambda play, seed=0: self.pilot(len(play.agents), play.task.period)
        return lambda play, seed=0: OneOfSeveral(self.pilot, view.fleet or "", play, seed)

    def check(self, play: Play, fleet: str | None) -> None:
        """Raise UsageError unless the agents of a fleet observe and command what this policy does.

        Args:
            play: the task and its world.
            fleet: of several; None: the only one.

        Raises:
            UsageError: they observe or command something else.
        """
        for what, mine, theirs in (
            ("observes", self.view.observed, observed_names(play, fleet)),
            ("commands", self.view.acts, tuple(axis.name for axis in side_of_fleet(play.sides, fleet).axes)),
        ):
            if mine != theirs:
                first = next((i for i, pair in enumerate(zip(mine, theirs, strict=False)) if pair[0] != pair[1]), None)
                # Of long lists the part that differs is shown.
                start = max(0, min(len(mine), len(theirs)) - 1 if first is None else first - 1)
                raise UsageError(
                    f"policy {self.name}: it {what} {_shown(mine, start)}; the task's agents have "
                    f"{_shown(theirs, start)}"
                )
        if not np.allclose(self.view.centre, still(side_of_fleet(play.sides, fleet).axes), atol=1e-4):
            raise UsageError(f"policy {self.name}: its throttle of hover is not 0, as the task's is; train it again")

    def pilot(self, agents: int, period: float) -> LearnedPolicy:
        """Return this policy as an object that acts for ``agents`` agents, at the start of their episodes.

        Args:
            agents: how many (n).
            period: time between two actions of the task [s].
        """
        return LearnedPolicy(self, agents, max(1, round(self.view.seconds / period)))


class LearnedPolicy:
    """Flies the agents of an episode by a policy file: the mean action, held between two decisions.

    Args:
        file: the policy.
        agents: how many.
        hold: steps of the task between two decisions.
    """

    def __init__(self, file: PolicyFile, agents: int, hold: int):
        self._file, self._hold, self._steps = file, hold, 0
        self._last = np.zeros((agents, file.view.remembered), np.float32)
        self._action: Any = None

    def act(self, seen: Floats) -> Floats:
        """Return the actions (n, A) in [-1, 1] for the observations (n, O) of one step."""
        file = self._file
        if self._steps % self._hold == 0:
            view, seen = file.view, np.asarray(seen)
            outputs = forward(file.layers, file.scaling.scaled(view.features(seen, self._last)))
            self._last = view.remember(outputs, seen, self._last)
            self._action = view.action(outputs.clip(-LIMIT, LIMIT), seen)
        self._steps += 1
        return self._action


def is_policy_file(source: object) -> bool:
    """Return whether ``source`` is the file name of a learned policy, by its suffix."""
    return isinstance(source, str | Path) and str(source).endswith(SUFFIX)


def read_policy(path: str | Path) -> PolicyFile:
    """Read a policy file.

    Raises:
        UsageError: there is no such file, or it is no policy or a damaged one.
    """
    name = str(path)
    with readable(path):
        data = read_bytes(path, LARGEST)
    arrays = read_arrays(f"policy {name}", data, MOST_NUMBERS)
    return policy_of(arrays, name)


def policy_of(arrays: dict[str, Any], name: str) -> PolicyFile:
    """Return the learned policy in the arrays of a policy file; ``name``: of the file, for messages.

    Raises:
        UsageError: they are no policy, or do not fit each other.
    """
    try:
        meta = json.loads(arrays[META].tobytes().decode())
        if meta["format"] != FORMAT:
            raise UsageError(f"policy {name}: its format is {meta['format']!r:.60}; this qrsim reads '{FORMAT}'")
        view = View(**{name: _frozen(value) for name, value in meta["view"].items()})
        count = sum(each.startswith("weights_") for each in arrays)
        layers = tuple((arrays[f"weights_{number}"], arrays[f"offset_{number}"]) for number in range(count))
        scaling = Scaling(arrays["mean"], arrays["deviation"])
        numbers = [scaling.mean, scaling.deviation, *(part for layer in layers for part in layer)]
        _check_shapes(view, scaling, layers)
        if not all(part.dtype == np.float32 and np.isfinite(part).all() for part in numbers):
            raise ValueError
        return PolicyFile(view, scaling, layers, dict(meta["facts"]), name)
    except UsageError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError):
        raise UsageError(f"policy {name}: is no policy that qrsim train has written, or it is damaged") from None


def observed_names(play: Play, fleet: str | None = None) -> tuple[str, ...]:
    """Return the names of the values in a task's observation, in order.

    Args:
        play: the task and its world.
        fleet: name of the one that observes, of several; None: the only one.

    Raises:
        UsageError: the task observes a dict, or has agents of several fleets.
    """
    axes = play.task.sees(play.world)
    if len(play.sides) > 1 and fleet is not None:
        axes = axes[fleet]
    elif len(play.sides) > 1 or isinstance(axes, dict):
        raise UsageError("a learned policy observes an array of numbers of one fleet; this task gives a dict")
    return tuple(axis.name for axis in axes)


def _check_shapes(view: View, scaling: Scaling, layers: Layers) -> None:
    """Raise ValueError if parts of a policy do not fit each other: sizes, indices, finite or positive numbers."""
    sizes = [view.inputs, *(weights.shape[1] for weights, _ in layers)]
    fits = [scaling.mean.shape == scaling.deviation.shape == (view.inputs,), bool(layers), sizes[-1] == len(view.flown)]
    for size, (weights, offset) in zip(sizes, layers, strict=False):
        fits += [weights.shape == (size, len(offset)), offset.ndim == 1]
    indices = [*view.kept, *(each for pair in view.pairs for each in pair), *([] if view.yaw is None else [view.yaw])]
    known = len(view.observed) + len(view.summed)
    fits += [all(0 <= each < known for each in indices), bool((scaling.deviation > 0.0).all())]
    fits += [all(0 <= each < len(view.observed) for each in (*(view.ahead or ()), *view.summed))]
    fits += [
        len(view.ahead or (0, 0)) == len(view.turned or (0, 0)) == 2,
        view.turned is None or view.ahead is not None,
    ]
    fits += [all(0 <= each < len(view.flown) for each in view.turned or ())]
    fits += [all(0 <= each < len(view.acts) for each in view.flown), view.seconds > 0.0]
    fits += [len(view.centre) == len(view.reach) == len(view.acts)]
    fits += [bool(np.isfinite([*view.centre, *view.reach, view.seconds]).all())]
    if not all(fits):
        raise ValueError


def _frozen(value: Any) -> Any:
    """Return parsed JSON with tuples in place of lists."""
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


def _shown(names: tuple[str, ...], start: int = 0) -> str:
    """Return names as one text for an error message; of many at most eight from number ``start`` on."""
    begun = start if len(names) > 8 else 0
    return "..., " * (begun > 0) + ", ".join(names[begun : begun + 8]) + ", ..." * (len(names) > begun + 8)
