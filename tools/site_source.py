"""Collect the pages of the site: docs/, and the pages of the repository that readers of the site want too.

Links between pages stay relative. A link to any other file of the repository becomes its address at the tag of this
version. Evidence (docs/evidence/) and programs (docs/writers/) stay out.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

# Names on the site of pages outside docs/; the README is the first page, so the list of all pages has another.
EXTRA = {
    "README.md": "index.md",
    "docs/index.md": "all_pages.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changelog.md",
    "clients/python/README.md": "reference/client_python.md",
    "clients/cpp/README.md": "reference/client_cpp.md",
    "clients/ros2/README.md": "reference/client_ros2.md",
}
LEFT_OUT = {"evidence", "writers", "__pycache__"}
# They have every word.
UNSEARCHED = ("CHANGELOG.md", "docs/index.md", "docs/project/history.md")
_LINK = re.compile(r"(?<=\]\()(?P<path>[^)\s#]+)(?P<anchor>#[^)\s]*)?(?=\))")
_FENCE = re.compile(r"^\s*(```+|~~~+)")


class BrokenLinkError(ValueError):
    """A link of a page leads to a file that the repository lacks."""


def pages(root: Path) -> dict[Path, str]:
    """Return the files of the site and their names on it.

    Args:
        root: the repository.
    """
    docs = root / "docs"
    files = (
        path
        for path in sorted(docs.rglob("*"))
        if path.is_file() and not LEFT_OUT.intersection(path.relative_to(docs).parts)
    )
    extra = {root / name: target for name, target in EXTRA.items()}
    return {path: path.relative_to(docs).as_posix() for path in files} | extra


def collect(root: Path, out: Path, address: str) -> int:
    """Write the pages into ``out``, changing only files that differ; return the number of links turned into addresses.

    Args:
        root: the repository.
        out: folder to write; files of earlier pages are removed from it.
        address: address of the repository's files at the tag, without a slash at the end.

    Raises:
        BrokenLinkError: a link leads to no file.
    """
    places = pages(root)
    turned = 0
    for source, name in places.items():
        target = out / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.suffix != ".md":
            if not target.exists() or target.stat().st_mtime < source.stat().st_mtime:
                shutil.copy(source, target)
            continue
        text, count = turn(source.read_text("utf-8"), source, places, root, address)
        turned += count
        if source.relative_to(root).as_posix() in UNSEARCHED:
            text = f"---\nsearch:\n  exclude: true\n---\n\n{text}"
        if not target.exists() or target.read_text("utf-8") != text:
            target.write_text(text, "utf-8")
    kept = {out / name for name in places.values()}
    for old in [path for path in out.rglob("*") if path.is_file() and path not in kept]:
        old.unlink()
    return turned


def turn(text: str, source: Path, places: dict[Path, str], root: Path, address: str) -> tuple[str, int]:
    """Return a page with its links as the site needs them, and the number of links turned into addresses."""
    count = 0

    def replaced(match: re.Match[str]) -> str:
        nonlocal count
        path, anchor = match["path"], match["anchor"] or ""
        if urlsplit(path).scheme:
            return match[0]
        target = (source.parent / path).resolve()
        if target in places:
            return os.path.relpath(places[target], Path(places[source]).parent) + anchor
        if not target.exists() or not target.is_relative_to(root):
            raise BrokenLinkError(f"{source.relative_to(root)}: link to '{path}', which does not exist")
        count += 1
        return f"{address}/{target.relative_to(root)}{anchor}"

    lines = [line if code else _LINK.sub(replaced, line) for line, code in _lines(text)]
    return "".join(lines), count


def _lines(text: str) -> Iterator[tuple[str, bool]]:
    """Yield each line, and whether it belongs to a block of code."""
    fence = ""
    for line in text.splitlines(keepends=True):
        found = _FENCE.match(line)
        if found and not fence:
            fence = found[1]
            yield line, True
        elif found and found[1].startswith(fence) and line.strip() == found[1]:
            fence = ""
            yield line, True
        else:
            yield line, bool(fence)
