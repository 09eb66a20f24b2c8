"""Requests to GDAL and PROJ, which run in a separate process, so that a crash there is an error of the file."""

from __future__ import annotations

import json
import os
import re
import struct
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from qrsim.errors import UsageError, shortened
from qrsim.extras import require
from qrsim.models.scene.terrain_files.gdal_process import HEAD, LARGEST_MEMORY

Float64 = npt.NDArray[np.float64]

PROCESS = Path(__file__).with_name("gdal_process.py")
LONGEST_S = 120.0
# Nothing but the file itself is opened, and nothing is fetched.
SETTINGS = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
    "GDAL_PAM_ENABLED": "NO",
    "GDAL_HTTP_TIMEOUT": "1",
    "GDAL_CACHEMAX": "64",
    "GDAL_NUM_THREADS": "1",
    "VSI_CACHE": "FALSE",
    "PROJ_NETWORK": "OFF",
    "OPENBLAS_NUM_THREADS": "1",
}


class GdalError(UsageError):
    """GDAL or PROJ refused a request.

    Attributes:
        reasons: its messages, the outermost first.
    """

    def __init__(self, text: str, reasons: list[str]):
        super().__init__(text)
        self.reasons = reasons


class Gdal:
    """A process with GDAL and PROJ, started by the first request and ended by ``with``.

    Each request names the file that it is about, for messages.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Gdal:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def describe(self, file: str, driver: str) -> dict[str, Any]:
        """Return a file's bands, dtype, shape, transform, crs (WKT), unit, overviews and palette."""
        return self._ask(file, {"ask": "describe", "file": _path(file), "driver": driver})[0]

    def read(self, file: str, rows: range, columns: range, *, coarse: bool, **source: object) -> npt.NDArray[Any]:
        """Return the heights [m] of a window, NaN where they are missing.

        Args:
            file: its path.
            rows: of the window, with a step.
            columns: of the window, with the same step.
            coarse: True returns a height (float32) for each whole block of cells, from overviews if the file has
                them; False returns the heights at the given rows and columns (float64).
            **source: driver, metres (of a unit of height) and nodata (list of further values for missing heights).
        """
        request = {"ask": "read", "file": _path(file), "coarse": coarse, "every": rows.step, **source}
        request |= {"rows": [rows.start, rows.stop], "columns": [columns.start, columns.stop]}
        _, data = self._ask(file, request)
        kind: type[np.float32 | np.float64] = np.float32 if coarse else np.float64
        return np.frombuffer(data, kind).reshape(len(rows), len(columns))

    def crs(self, file: str, text: str, site: tuple[float, float], esri: bool = False) -> dict[str, Any]:
        """Return wkt, name, kind, wgs84 and accuracy of a system given as EPSG:n or WKT; site: its place [deg]."""
        return self._ask(file, {"ask": "crs", "text": text, "site": site, "esri": esri})[0]

    def transform(self, file: str, source: str, target: str, x: Float64, y: Float64) -> tuple[Float64, Float64]:
        """Return x and y of any shape in another system; longitude and latitude [deg] of a geographic one."""
        points = np.stack([x.ravel(), y.ravel()])
        _, data = self._ask(file, {"ask": "transform", "from": source, "to": target}, points.tobytes())
        found = np.frombuffer(data, np.float64).reshape(2, *x.shape)
        return found[0], found[1]

    def _ask(self, file: str, request: dict[str, Any], payload: bytes = b"") -> tuple[dict[str, Any], bytes]:
        """Send a request to GDAL's process and return its answer and data; raise UsageError for failures."""
        process = self._running(file)
        text = json.dumps(request).encode()
        alarm = threading.Timer(LONGEST_S, process.kill)
        alarm.start()
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(HEAD.pack(len(text), len(payload)) + text + payload)
            process.stdin.flush()
            length, size = HEAD.unpack(process.stdout.read(HEAD.size))
            answer = json.loads(process.stdout.read(length))
            data = process.stdout.read(size)
            if len(data) != size:
                raise EOFError
        # It has ended: broken pipes, and answers that are not whole.
        except (OSError, EOFError, ValueError, struct.error):
            self._end()
            raise UsageError(f"{file}: cannot be read: GDAL ended on it, or took longer than {LONGEST_S:g} s") from None
        finally:
            alarm.cancel()
        if "error" in answer:
            raise _refusal(file, [str(each) for each in answer["error"]])
        return answer, data

    def _running(self, file: str) -> subprocess.Popen[bytes]:
        """Return GDAL's process, started at first use."""
        if self._process is None:
            require("terrain", f"reading {file}", "rasterio")
            self._process = subprocess.Popen(
                # -P: the modules of its folder do not hide others.
                [sys.executable, "-P", str(PROCESS)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=os.environ | SETTINGS,
            )
        return self._process

    def _end(self) -> None:
        """Kill the process."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()


def _path(file: str) -> str:
    return os.path.abspath(os.path.expanduser(file))


def _refusal(file: str, reasons: list[str]) -> UsageError:
    """Return the error for what GDAL says of a file."""
    if any(reason.startswith("MemoryError") or "out of memory" in reason.lower() for reason in reasons):
        return GdalError(f"{file}: cannot be read: it takes more than {LARGEST_MEMORY / 1e9:g} GB", reasons)
    if broken := next((each for each in reasons if each.startswith(("ImportError", "ModuleNotFoundError"))), None):
        # No fault of the file or of a code, so no GdalError.
        return UsageError(f"{file}: cannot be read: rasterio does not work here: {shortened(broken, 200)}")
    for reason in reasons:
        if block := re.search(r"X offset (\d+), Y offset (\d+)", reason):
            return GdalError(f"{file}: cannot be read: block ({block[2]}, {block[1]}) is damaged", reasons)
    inner = reasons[-1].partition(": ")[2].replace(_path(file), Path(file).name)
    return GdalError(f"{file}: cannot be read: {shortened(inner or reasons[-1], 200)}", reasons)
