"""Write src/qrsim/models/egm96.zlib: ``python -m tools.geoid_grid egm96-5.npz``.

The input is the EGM96 grid of 5 minutes of arc in the package egm96 0.3.0 (``egm96/data/egm96-5.npz``, MIT), which has
it from GeographicLib. The output has every third point: 721 rows from the north pole, 1440 columns from Greenwich
eastwards. They are whole centimetres as int16, little-endian, their differences along latitude and then along
longitude, compressed by zlib.
"""

from __future__ import annotations

import sys
import zlib
from pathlib import Path

import numpy as np

TARGET = Path(__file__).parents[1] / "src" / "qrsim" / "models" / "egm96.zlib"


def packed(source: Path) -> bytes:
    """Return the content of the file, from a grid of 5 minutes with rows from the south and columns from 180 W."""
    with np.load(source) as data:
        second = data["undulation_d2"].astype(np.int32)
    if second.shape != (2161, 4321):
        raise SystemExit(f"{source}: has {second.shape} points; expected (2161, 4321)")
    centimetres = np.cumsum(np.cumsum(second, axis=0), axis=1)
    # The last column is the first one again.
    every_third = np.roll(centimetres[::-1, :-1], 2160, axis=1)[::3, ::3]
    differences = np.diff(np.diff(every_third, axis=0, prepend=0), axis=1, prepend=0)
    return zlib.compress(differences.astype("<i2").tobytes(), 9)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("usage: python -m tools.geoid_grid egm96-5.npz")
    print(TARGET, TARGET.write_bytes(packed(Path(sys.argv[1]))), "bytes")
