"""A simulation's whole state as bytes, and back."""

from __future__ import annotations

import hashlib
import io
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from qrsim.control import MissionState, RouteState
from qrsim.core.arrays import NumpyArray
from qrsim.engine.layout import Buffers, Packer
from qrsim.errors import RunError, UsageError, os_error_as
from qrsim.files import Content
from qrsim.files.atomic import write_atomically
from qrsim.models.gnss.receivers import SharedSky
from qrsim.models.gnss.slots import SlottedSky
from qrsim.models.gnss.sp3 import Sp3Orbits
from qrsim.models.scene.area import REASONS
from qrsim.models.scene.terrain import OCCLUSION
from qrsim.simulation.archive import DamagedError, OtherNamesError, read_archive
from qrsim.simulation.arguments import LARGEST_TICK
from qrsim.world.state import Fleet, FleetState, State, World, WorldKeys

FORMAT = 5
NAMES = ("format", "floats", "integers", "tick", "seed", "number", "name", "world", "injections")
LARGEST_SEED, LARGEST_NUMBER = 2**63 - 1, 2**32 - 1
# No state comes near it: a thousand vehicles take 600 kB.
LARGEST_FILE = 2**28
# Fields that may be NaN: missing readings, and numbers that were never commanded.
MAY_BE_NAN = ("readings", "true_readings", "passed_on", "fitted", "sensors", "setpoint", "controller", "violation")
# Fields that may be NaN for a vehicle that has stopped.
MAY_BE_NAN_ONCE_STOPPED = ("command", "estimate")


@dataclass(frozen=True)
class SavedState:
    """A saved state.

    Attributes:
        floats, integers: the packed state.
        tick: steps done.
        seed, number: of all randomness.
        name: of the scenario.
        world: fingerprint of the world's structure and parameters.
        injections: faults that were injected, as JSON.
    """

    floats: NumpyArray
    integers: NumpyArray
    tick: int
    seed: int
    number: int
    name: str
    world: str
    injections: str = "[]"

    def to_bytes(self) -> bytes:
        """Return the saved state as bytes: an uncompressed NumPy archive (.npz)."""
        buffer = io.BytesIO()
        content: Content = {name: getattr(self, name, FORMAT) for name in NAMES}
        np.savez(buffer, **content)
        return buffer.getvalue()

    @staticmethod
    def of(source: bytes | str | Path) -> SavedState:
        """Read a saved state from bytes or a file; checks all that needs no simulation.

        Raises:
            UsageError: the file is missing, or this is no saved state of this version, or a damaged one.
        """
        where = "saved state" if isinstance(source, bytes | bytearray | memoryview) else f"saved state {source}"
        try:
            content = read_archive(_data(source, where), NAMES)
        except DamagedError:
            raise UsageError(f"{where}: this is no state that qrsim saved, or it is damaged") from None
        except OtherNamesError:
            raise _another_version(where) from None
        if _integer(content["format"]) != FORMAT:
            raise _another_version(where)
        return SavedState(
            _buffer(where, "floats", content, ("float32", "float64")),
            _buffer(where, "integers", content, ("int32",)),
            _number(where, "tick", content, LARGEST_TICK),
            _number(where, "seed", content, LARGEST_SEED),
            _number(where, "number", content, LARGEST_NUMBER),
            _text(where, "name", content),
            _text(where, "world", content),
            _text(where, "injections", content),
        )

    def check(self, name: str, world: str) -> None:
        """Raise UsageError if the state was saved by another scenario (``name``) or with other parameters (``world``:
        their digest).

        Raises:
            UsageError: the name or a parameter of the world differs.
        """
        if self.name != name:
            raise UsageError(f"saved state: it is of the scenario {self.name!r}, this simulation is {name!r}")
        if self.world != world:
            raise UsageError(
                f"saved state: it is of '{name}' with other parameters, vehicles, sensors or precision than here"
            )

    def buffers(self, layout: Packer, like: Buffers) -> Buffers:
        """Return the saved state as buffers; raises UsageError unless they have the types and sizes of ``like``.

        Args:
            layout: of both.
            like: the other one.

        Raises:
            UsageError: it has another type or size.
        """
        for what, part, own in zip(("floats", "integers"), (self.floats, self.integers), like, strict=True):
            if part.dtype != own.dtype:
                raise UsageError(f"saved state: its {what} are {part.dtype}, those of this simulation {own.dtype}")
            if part.shape != own.shape:
                raise UsageError(
                    f"saved state: it has {part.size} {what}, this simulation's state {own.size}: "
                    "it is of another version"
                )
        for number, dtype in enumerate(layout.dtypes):
            values = self.integers[layout.slices[number]]
            if dtype.kind == "b" and not ((values == 0) | (values == 1)).all():
                raise UsageError(f"saved state: it is damaged: {values[(values & ~1) != 0][0]} is neither 0 nor 1")
        return self.floats, self.integers

    def check_state(self, world: World, state: State, keys: WorldKeys) -> None:
        """Raise UsageError for a saved state that is impossible in this world, such as one with values out of range.

        Args:
            world: of this simulation.
            state: unpacked, NumPy arrays.
            keys: of this state's seed and number, ``world.keys_of``.

        Raises:
            UsageError: something is not finite or out of its range, or it is not of its own seed.
        """
        for where, leaf in _finite_leaves(world, state):
            if not np.isfinite(leaf).all():
                raise UsageError(f"saved state: it is damaged: {where} is not finite")
        for where, leaf, low, high in _ranges(world, state, self.tick):
            wrong = (leaf < low) | (leaf > high)
            if wrong.any():
                raise UsageError(
                    f"saved state: it is damaged: {where} is {leaf[wrong].flat[0]}; allowed: {low} to {high}"
                )
        own, given = (keys.sky, keys.fleets, keys.plume), (state.sky_keys, state.fleet_keys, state.contents_keys)
        if not all(map(np.array_equal, jax.tree.leaves(own), jax.tree.leaves(given))):
            raise UsageError(f"saved state: it is damaged: its randomness is not that of its seed, {self.seed}")


def _data(source: object, where: str) -> bytes:
    """Return the bytes of a saved state, given as bytes or as a file; raises UsageError if too large. ``where``: for
    messages."""
    if isinstance(source, bytes | bytearray | memoryview):
        size = memoryview(source).nbytes
    elif isinstance(source, str | Path):
        size, source = _file(Path(source), where)
    else:
        raise UsageError(f"saved state: expected bytes or the path of a file, found {type(source).__name__}")
    if size > LARGEST_FILE:
        raise UsageError(f"{where}: {size} bytes; a saved state has at most {LARGEST_FILE}")
    return source.read_bytes() if isinstance(source, Path) else bytes(source)


def _file(path: Path, where: str) -> tuple[int, Path]:
    """Return a file's size [bytes] and its path; raises UsageError, beginning with ``where``, if it cannot be read."""
    try:
        found = path.stat()
    except (OSError, ValueError) as error:
        raise UsageError(f"{where}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if not stat.S_ISREG(found.st_mode):
        raise UsageError(f"{where}: cannot be read: it is not a regular file")
    return found.st_size, path


def _another_version(where: str) -> UsageError:
    """Return the error, beginning with ``where``, for a state that another version of qrsim saved."""
    return UsageError(f"{where}: it was saved by another version of qrsim, or not by qrsim")


def _integer(array: NumpyArray) -> int | None:
    """Return the integer in an array of shape (); None if the array is anything else."""
    return int(array) if array.shape == () and array.dtype.kind in "iu" else None


def _number(where: str, name: str, content: Content, largest: int) -> int:
    """Return an integer, 0 to ``largest``, from a saved state's arrays by name; raises UsageError, beginning with
    ``where``."""
    found = _integer(content[name])
    if found is None or not 0 <= found <= largest:
        what = content[name].dtype if found is None else found
        raise UsageError(f"{where}: its {name} is {what}; expected a whole number from 0 to {largest}")
    return found


def _text(where: str, name: str, content: Content) -> str:
    """Return a text from a saved state's arrays by name; raises UsageError, beginning with ``where``, for others."""
    array = content[name]
    try:
        if array.shape == () and array.dtype.kind == "U":
            return str(array)
    except ValueError:  # it is no Unicode
        pass
    raise UsageError(f"{where}: its {name} is no text")


def _buffer(where: str, name: str, content: Content, known: tuple[str, ...]) -> NumpyArray:
    """Return a 1-D array from a saved state's arrays by name; raises UsageError, beginning with ``where``, unless its
    dtype is ``known``."""
    array = content[name]
    if array.ndim != 1 or array.dtype.name not in known or not array.dtype.isnative:
        raise UsageError(
            f"{where}: its {name} are {array.dtype} of shape {array.shape}; expected {' or '.join(known)}, one row"
        )
    return array


def _finite_leaves(world: World, state: State) -> Iterator[tuple[str, NumpyArray]]:
    """Yield (description for messages, array) of all numbers in a state that must be finite."""
    # Recorded orbits end, and have gaps.
    recorded = isinstance(world.sky, SharedSky | SlottedSky) and isinstance(world.sky.orbits, Sp3Orbits)
    if not recorded:
        yield from _floats("the sky", state.sky)
    yield from _floats("what the episode has drawn", state.drawn)
    yield from _floats("what the area holds", state.contents)
    for number, fleet in enumerate(state.fleets):
        flies = np.asarray(fleet.violation.code) == 0
        for name in FleetState.__dataclass_fields__:
            if name not in MAY_BE_NAN:
                here = f"the {name.replace('_', ' ')} of fleet {number}"
                stopped = name in MAY_BE_NAN_ONCE_STOPPED
                yield from _floats(here, getattr(fleet, name), flies if stopped else None)
        for name, part in _without_infinity(world.fleets[number], fleet):
            for here, leaf in _floats(f"what the {name} of fleet {number} remembers", part, flies):
                # Of one that has stopped because a number was not finite, that number may be left.
                if flies.all() or leaf.shape[:1] == (flies.sum(),):
                    yield here, leaf[~np.isnan(leaf)]


def _without_infinity(fleet: Fleet, state: FleetState) -> Iterator[tuple[str, object]]:
    """Yield (description for messages, array) of parts of a fleet's state that may be NaN but not infinite, of built-in
    components only."""
    for sensor, memory, reading, true in zip(
        fleet.sensors, state.sensors, state.readings, state.true_readings, strict=True
    ):
        if type(sensor).__module__.startswith("qrsim."):
            yield "sensors", (memory, reading, true)
    if type(fleet.controller).__module__.startswith("qrsim."):
        yield "controller", (state.controller, state.setpoint)


def _floats(where: str, tree: object, flies: NumpyArray | None = None) -> Iterator[tuple[str, NumpyArray]]:
    """Yield (``where``, float array) for each one in a tree; only the rows of vehicles that fly, if ``flies`` is
    given."""
    for leaf in jax.tree.leaves(tree):
        if np.issubdtype(leaf.dtype, np.floating):
            yield where, leaf if flies is None or leaf.shape[:1] != flies.shape else leaf[flies]


def _ranges(world: World, state: State, tick: int) -> Iterator[tuple[str, Any, float, float]]:
    """Yield (description for messages, values, least, greatest) of all numbers in a state that have a range."""
    for number, (fleet, now) in enumerate(zip(world.fleets, state.fleets, strict=True)):
        here = f"of fleet {number}"
        yield f"the reason why a vehicle stopped, {here},", now.violation.code, 0, len(REASONS) - 1
        last = max(0, len(fleet.route.yaw) - 1)
        if now.position_low_ned is not None:
            for axis in "xyz":
                # Half the spacing of numbers as large as the position, or as the way of any tick where that is larger.
                largest = np.max(np.abs(getattr(now.vehicle.position_ned, axis)), initial=1000.0)
                most = 0.5 * float(np.spacing(largest))
                yield f"the second part of a position {here}", getattr(now.position_low_ned, axis), -most, most
        if isinstance(now.guidance, RouteState | MissionState):
            yield f"the number of a waypoint {here}", now.guidance.index, 0, last
            yield f"the number of waypoints reached {here}", now.guidance.reached, 0, tick + 1
    contents = state.contents
    for name, what, low, high in (
        ("terrain", "classes", 0, OCCLUSION),
        ("persons", "found_tick", -1, tick),
        ("plume", "released", 0, tick + 1),
    ):
        part = getattr(contents, name)
        if part is not None and what in vars(part):
            yield f"{what.replace('_', ' ')} of the {name}", getattr(part, what), low, high


def write(path: str | Path, data: bytes) -> None:
    """Write the bytes of a saved state to a file; raises RunError if that fails.

    Raises:
        RunError: it cannot be written.
    """
    with os_error_as(RunError, f"cannot write the saved state {path}"):
        write_atomically(Path(path), data)


def fingerprint(layout: Packer, buffers: Buffers) -> str:
    """Return a SHA-256 digest of a packed tree: its structure, dtypes and values."""
    digest = hashlib.sha256(repr((layout.structure, layout.shapes, layout.dtypes)).encode())
    for buffer in buffers:
        digest.update(np.asarray(buffer).tobytes())
    return digest.hexdigest()
