"""Damaged files of weather models: each is read, or refused in words, soon; none is a traceback."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tests.weather_files as files

from qrsim.errors import UsageError
from qrsim.files.in_child import ChildError, in_child
from qrsim.models.atmosphere.weather.grib import grib_values
from qrsim.models.atmosphere.weather.netcdf import netcdf_values
from qrsim.models.atmosphere.weather.soundings import Site, soundings_of
from qrsim.models.atmosphere.weather.table import read_table
from qrsim.models.atmosphere.weather.values import Request

SEED = 20261126
LIMIT_S = 2.0
START = files.BEGIN.timestamp()
REQUEST = Request(51.7119, -0.21052, START + 600.0, START + 5000.0, None)
TABLE = b"time,height,speed,direction\n2026-05-01T09:00Z,10,4,180\n2026-05-01T11:00Z,10,8,180\n"


def mutated(content: bytes, number: int) -> bytes:
    """Return content with some bytes changed, a part removed, repeated or cut off."""
    random = np.random.default_rng([SEED, number])
    changed = bytearray(content)
    for _ in range(int(random.integers(1, 6))):
        if not changed:
            break
        at, length = int(random.integers(len(changed))), int(random.integers(1, 40))
        match int(random.integers(5)):
            case 0 | 1:
                changed[at] = int(random.integers(256))
            case 2:
                del changed[at : at + length]
            case 3:
                changed[at:at] = changed[at : at + length]
            case _:
                changed[at : at + length] = random.bytes(length)
    return bytes(changed[: int(random.integers(len(changed) + 1))] if random.random() < 0.1 else changed)


def hand_in(kind: str, source: str, folder: str, first: int, last: int) -> dict[str, int]:
    """Read mutations of a file, and count what comes of them; the number of the last one begun is in a file."""
    reader: Any = {"nc": netcdf_values, "grib2": grib_values}.get(kind)
    content, counts = Path(source).read_bytes(), {"taken": 0, "refused": 0, "error": 0}
    for number in range(first, last):
        Path(folder, "at").write_text(str(number))
        path = Path(folder, f"m.{kind}")
        path.write_bytes(mutated(content, number))
        begin = time.process_time()
        try:
            if reader is None:
                read_table(str(path), 0.05)
            else:
                values = reader("FILE", str(path), REQUEST)
                try:
                    soundings_of("FILE", values, REQUEST, Site(30.0, "sea", 0.05))
                except UsageError:
                    raise
                except Exception as error:  # outside of the child it would be a traceback
                    raise SystemExit(f"mutation {number}: {error!r}") from None
            counts["taken"] += 1
        except UsageError:
            counts["refused"] += 1
        except Exception:
            if reader is None:
                raise
            # The child's parent says that the file cannot be read.
            counts["error"] += 1
        spent = time.process_time() - begin
        assert spent < LIMIT_S, f"mutation {number} took {spent:.1f} s"
    return counts


def outcomes(kind: str, source: Path, folder: Path, count: int) -> dict[str, int]:
    """Return what comes of mutations; a crash of a decoder ends its child, and another goes on after it."""
    counts, first = {"taken": 0, "refused": 0, "error": 0, "crash": 0}, 0
    while first < count:
        last = min(first + 100, count)
        try:
            found = in_child(hand_in, kind, str(source), str(folder), first, last)
        except ChildError as error:
            if "crashed" not in str(error):
                raise
            last = int((folder / "at").read_text()) + 1
            found = {"crash": 1}
        for name, number in found.items():
            counts[name] += number
        first = last
    return counts


def written(kind: str, folder: Path) -> Path:
    path = folder / f"source.{kind}"
    if kind == "csv":
        path.write_bytes(TABLE)
        return path
    return files.single_levels(path) if kind == "nc" else files.grib(path, [0, 1, 2])


@pytest.mark.parametrize(("kind", "count"), [("csv", 200), ("nc", 30), ("grib2", 15)])
def test_some_mutations(kind: str, count: int, tmp_path: Path) -> None:
    found = outcomes(kind, written(kind, tmp_path), tmp_path, count)
    assert found["refused"] + found["error"] > 0


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["csv", "nc", "grib2"])
def test_two_thousand_mutations(kind: str, tmp_path: Path) -> None:
    found = outcomes(kind, written(kind, tmp_path), tmp_path, 2000)
    assert found["taken"] > 0
    assert found["refused"] > 0
