"""Write the pictures of the gallery: ``python -m docs.writers.gallery [NAME ...]``.

The code of docs/gallery/NAME.md saves docs/images/gallery_NAME.png.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from docs.writers.pictures import GALLERY, IMAGES, write_named

FOLDER = IMAGES.parent / "gallery"


def code(name: str) -> str:
    """Return the block of Python of a page.

    Raises:
        ValueError: the page has none, or several.
    """
    page = (FOLDER / f"{name}.md").read_text("utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    return str(block)


def write(name: str, output: Path = IMAGES) -> Path:
    """Run the block of a page, and copy the picture that it saves; return where it is."""
    import matplotlib

    matplotlib.use("Agg")
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        exec(compile(code(name), f"docs/gallery/{name}.md", "exec", dont_inherit=True), {"__name__": name})
        return Path(shutil.copy(f"gallery_{name}.png", output))


def main(names: Sequence[str]) -> int:
    """Write the named pictures; return the exit code."""
    return write_named(names, "examples", GALLERY, write)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
