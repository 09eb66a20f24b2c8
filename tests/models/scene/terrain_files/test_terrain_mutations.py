"""Mutations of terrain files: each is read or refused in words, soon and in little memory."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from evidence._processes import peak_bytes, reset_peak, resident_bytes
from tests.models.scene.terrain_maps import BOX, SITE, geotiff, hgt, utm_ascii, vrt
from tests.wrong_input.mutating import mutated

from qrsim.errors import UsageError
from qrsim.models.scene.terrain_files.gdal import Gdal
from qrsim.models.scene.terrain_files.survey import Wanted, survey

pytest.importorskip("rasterio")
SEED = 20261126
LIMIT_S, LIMIT_BYTES = 2.0, 10**9


def seeds(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield a name and a small file of each reader, with what it is mutated in."""
    yield "tif", Path(geotiff(folder / "seed.tif", "EPSG:32630", 60.0, compress="deflate", predictor=3))
    tiled = {"tiled": True, "blockxsize": 16, "blockysize": 16, "nodata": -9999.0}
    yield "tiled.tif", Path(geotiff(folder / "tiled.tif", "EPSG:4326", 60.0, compress="lzw", **tiled))
    yield "vrt", Path(vrt(folder / "seed.vrt", "tiled.tif"))
    yield "asc", Path(utm_ascii(folder / "seed.asc"))
    yield "prj", folder / "seed.prj"
    yield "hgt", Path(hgt(folder / "N51W001.hgt"))


def processor_s(gdal: Gdal) -> float:
    """Return the seconds of the processor that GDAL's process has taken."""
    if gdal.child.number is None:
        return 0.0
    words = Path(f"/proc/{gdal.child.number}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def attempt(folder: Path, kind: str, number: int, seed: Path, gdal: Gdal) -> str:
    """Mutate a file, read it, and return what came of it."""
    rng = np.random.default_rng([SEED, number])
    data = mutated(rng, seed.read_bytes(), binary=kind not in ("vrt", "asc", "prj"))
    # The process keeps files open by their names.
    stem = "N51W001" if kind == "hgt" else f"case{number}"
    path = folder / f"{stem}.{kind.rpartition('.')[2]}"
    path.write_bytes(data)
    file = path
    if kind == "prj":
        file = path.with_suffix(".asc")
        file.write_bytes(seed.with_suffix(".asc").read_bytes())
    elif kind == "asc":
        path.with_suffix(".prj").write_bytes(seed.with_suffix(".prj").read_bytes())
    before = time.process_time(), processor_s(gdal)
    try:
        found = survey(Wanted(str(file), "", 1, False, None, 50_000.0), SITE, BOX, gdal)
        found.grid(np.linspace(-500.0, 500.0, 50), np.linspace(-500.0, 500.0, 50))
        outcome = "read"
    except UsageError as error:
        outcome = "refused"
        said = str(error)
    if outcome == "refused":
        assert "\n" not in said
        # That of the file, or of a source of it.
        assert str(folder) in said
    spent = time.process_time() - before[0], processor_s(gdal) - before[1]
    assert max(spent) < LIMIT_S, (kind, number, spent)
    for each in {path, file, path.with_suffix(".prj")} - {seed}:
        each.unlink(missing_ok=True)
    return outcome


@pytest.mark.parametrize(
    "count", [pytest.param(30, marks=pytest.mark.long), pytest.param(2000, marks=pytest.mark.nightly)]
)
def test_each_is_read_or_refused(tmp_path: Path, count: int) -> None:
    kinds = list(seeds(tmp_path))
    reset_peak()
    held = resident_bytes()
    for kind, seed in kinds:
        folder = tmp_path / f"of {kind}"
        folder.mkdir()
        if kind == "vrt":
            (folder / "tiled.tif").write_bytes((tmp_path / "tiled.tif").read_bytes())
        outcomes: Counter[str] = Counter()
        with Gdal() as gdal:
            for number in range(count):
                outcomes[attempt(folder, kind, number, seed, gdal)] += 1
        # Mutations that are all refused, or all read, would say little.
        assert min(outcomes["read"], outcomes["refused"]) > count // 20, (kind, outcomes)
    # Not the peak of this process's life: the tests before may have held more.
    assert peak_bytes() - held < LIMIT_BYTES
