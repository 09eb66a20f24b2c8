"""Writing the pictures of studies."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def picture(
    path: Path, size: tuple[float, float], *shape: int, dpi: int = 110, legends: bool = True, **more: Any
) -> Iterator[Any]:
    """Yield the axes of a new figure, with grids; add legends where labels are new, and write it.

    Args:
        path: of the file.
        size: width and height [inch].
        shape: rows and columns of axes; none: one.
        dpi: dots per inch.
        legends: whether to add those that the axes do not have yet.
        more: options of matplotlib's ``Figure.subplots``.
    """
    import matplotlib as mpl

    from qrsim.runs.picture import new_figure

    with mpl.rc_context({"axes.grid": True, "grid.alpha": 0.3, "legend.fontsize": 8}):
        figure = new_figure(*size)
        yield figure.subplots(*shape, **more)
        known: list[list[str]] = [[]]
        for axes in figure.axes:
            labels = axes.get_legend_handles_labels()[1]
            if legends and labels not in known and axes.get_legend() is None:
                axes.legend()
            known.append(labels)
        figure.savefig(path, dpi=dpi)
