"""Writing the pictures of studies."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def picture(path: Path, size: tuple[float, float], *shape: int, dpi: int = 110, **more: Any) -> Iterator[Any]:
    """Yield the axes of a new figure, and write it at the end.

    Args:
        path: of the file.
        size: width and height [inch].
        shape: rows and columns of axes; none: one.
        dpi: dots per inch.
        more: options of matplotlib's ``Figure.subplots``.
    """
    from qrsim.runs.picture import new_figure

    figure = new_figure(*size)
    yield figure.subplots(*shape, **more)
    figure.savefig(path, dpi=dpi)
