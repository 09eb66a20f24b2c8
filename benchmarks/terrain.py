"""How long a world with terrain files takes: a tile of 3600 x 3600 heights for 1 km, and a horizon over four tiles.

Heights are float32, deflated with predictor 3, without overviews, as in the tiles of Copernicus GLO-30. Each row is a
process of its own, which imports everything before the clock starts; the memory is that which reading adds to its peak,
and the peak of the process that runs GDAL.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import _common

SIDE, SMALL_SIDE = 3600, 360
TARGETS = {"one tile": (1.0, 200.0), "four tiles": (4.0, None)}
HEADINGS = {
    "files": "files",
    "wall_s": "wall [s]",
    "cpu_s": "CPU [s]",
    "own_mb": "memory [MB]",
    "gdal_mb": "GDAL's [MB]",
    "target_s": "target [s]",
    "target_mb": "target [MB]",
}
READ = """
import json, resource, sys, time
from qrsim.models.scene.elevation_file import ElevationFile
from qrsim.models.site import Site
import pymap3d, rasterio

def seconds(who):
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime

def peak():
    # That of getrusage may be the peak of who started this process.
    return int(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))

both = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
before, began, cpu = peak(), time.perf_counter(), sum(map(seconds, both))
ElevationFile(tuple(sys.argv[1:])).at(Site.from_degrees(51.99, -0.02), (-500.0, 500.0, -500.0, 500.0))
wall, cpu = time.perf_counter() - began, sum(map(seconds, both)) - cpu
own, child = peak() - before, resource.getrusage(both[1]).ru_maxrss
print(json.dumps({"wall_s": wall, "cpu_s": cpu, "own_mb": own / 1024, "gdal_mb": child / 1024}))
"""


def tile(folder: Path, south: int, west: int, side: int) -> str:
    """Write a tile of one degree by one degree, with hills of several sizes."""
    import rasterio

    latitude = south + 1.0 - (np.arange(side) + 0.5) / side
    longitude = west + (np.arange(side) + 0.5) / side
    rng = np.random.default_rng(south * 1000 + west)
    heights = 200.0 + rng.normal(0.0, 0.5, (side, side))
    for size in (3.0, 17.0, 90.0):
        heights += (60.0 / size) * np.sin(size * latitude)[:, None] * np.cos(1.3 * size * longitude)[None, :]
    path = folder / f"{south}_{west}.tif"
    place = rasterio.Affine(1.0 / side, 0.0, west, 0.0, -1.0 / side, south + 1.0)
    profile = {"width": side, "height": side, "count": 1, "dtype": "float32", "crs": "EPSG:4326", "transform": place}
    tiled = {"tiled": True, "blockxsize": 256, "blockysize": 256, "compress": "deflate", "predictor": 3}
    with rasterio.open(path, "w", "GTiff", **profile, **tiled) as file:
        file.write(heights.astype(np.float32), 1)
    return str(path)


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return a row for one tile and one for four."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        side = SMALL_SIDE if quick else SIDE
        files = [tile(Path(name), south, west, side) for south, west in ((51, -1), (51, 0), (52, -1), (52, 0))]
        for what, some in (("one tile", files[:1]), ("four tiles", files)):
            command = [sys.executable, "-c", READ, *some]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
            found = {key: round(value, 3) for key, value in json.loads(done.stdout).items()}
            target = TARGETS[what]
            rows.append({"files": what, **found, "target_s": target[0], "target_mb": target[1]})
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    title = "Ground of 1 km by 1 km, and the horizon to 50 km, from float32 tiles"
    _common.publish("terrain", title, on, measure(chosen.quick), HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
