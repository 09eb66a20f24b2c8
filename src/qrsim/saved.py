"""A simulation's whole state as bytes, and back."""

from __future__ import annotations

import hashlib
import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.core.pack import Buffers, Packer
from qrsim.errors import RunError, UsageError

FORMAT = 2


@dataclass(frozen=True)
class SavedState:
    """What is saved.

    Attributes:
        floats, integers: the packed state.
        tick: steps done.
        seed: of all randomness.
        name: of the scenario.
        world: fingerprint of the world's structure and parameters.
    """

    floats: np.ndarray[Any, Any]
    integers: np.ndarray[Any, Any]
    tick: int
    seed: int
    name: str
    world: str

    def to_bytes(self) -> bytes:
        """Return the state as a NumPy archive."""
        buffer = io.BytesIO()
        np.savez(
            buffer,
            format=FORMAT,
            floats=self.floats,
            integers=self.integers,
            tick=self.tick,
            seed=self.seed,
            name=self.name,
            world=self.world,
        )
        return buffer.getvalue()

    @staticmethod
    def of(source: bytes | str | Path) -> SavedState:
        """Read a state from bytes or a file.

        Raises:
            UsageError: the file is missing, or this is no saved state of this version.
        """
        where = "saved state" if isinstance(source, bytes) else f"saved state {source}"
        try:
            data = source if isinstance(source, bytes) else Path(source).read_bytes()
            with np.load(io.BytesIO(data), allow_pickle=False) as archive:
                content = {name: archive[name] for name in archive.files}
        except OSError as error:
            raise UsageError(f"{where}: cannot be read: {error.strerror or error}") from None
        except (ValueError, EOFError, zipfile.BadZipFile):
            raise UsageError(f"{where}: this is no state that qrsim saved, or it is damaged") from None
        expected = {"format", "floats", "integers", "tick", "seed", "name", "world"}
        if set(content) != expected or int(content["format"]) != FORMAT:
            raise UsageError(f"{where}: it was saved by another version of qrsim, or not by qrsim")
        return SavedState(
            content["floats"],
            content["integers"],
            int(content["tick"]),
            int(content["seed"]),
            str(content["name"]),
            str(content["world"]),
        )

    def check(self, name: str, world: str) -> None:
        """Refuse a state of another scenario.

        Raises:
            UsageError: the name or a parameter of the world differs.
        """
        if self.name != name:
            raise UsageError(f"saved state: it is of the scenario '{self.name}', this simulation is '{name}'")
        if self.world != world:
            raise UsageError(
                f"saved state: it is of '{name}' with other parameters, vehicles, sensors or precision than here"
            )


def write(path: str | Path, data: bytes) -> None:
    """Write a saved state to a file.

    Raises:
        RunError: it cannot be written.
    """
    try:
        Path(path).write_bytes(data)
    except OSError as error:
        raise RunError(f"cannot write the saved state {path}: {error.strerror or error}") from None


def fingerprint(layout: Packer, buffers: Buffers) -> str:
    """Return a digest of a tree's structure, types and values."""
    digest = hashlib.sha256(repr((layout.structure, layout.shapes, layout.dtypes)).encode())
    for buffer in buffers:
        digest.update(np.asarray(buffer).tobytes())
    return digest.hexdigest()
