"""The documentation site as a zip whose pages are opened as files, search included: ``python -m tools.site zip``."""

from __future__ import annotations

import os
import re
import zipfile
from pathlib import Path

WORKER = Path(__file__).with_name("offline_worker.js")
SHIM = "https://unpkg.com/iframe-worker/shim"
# Of every entry, so that the same pages make the same bytes.
DATE = (1980, 1, 1, 0, 0, 0)


def configuration(text: str) -> str:
    """Return mkdocs.yml with the plugin ``offline``, its own folder, and without the selector of versions."""
    text = re.sub(r"^  version: .*\n", "", text, flags=re.MULTILINE)
    text = text.replace("\nplugins:\n", "\nplugins:\n  - offline\n", 1)
    return text.replace("\nsite_dir: build/site\n", "\nsite_dir: build/site-offline\n", 1)


def complete(site: Path) -> int:
    """Put the worker into the site, and its address into the pages; return the number of pages changed.

    Args:
        site: folder of the built site.
    """
    target = site / "assets" / WORKER.name
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(WORKER.read_bytes())
    changed = 0
    for page in site.rglob("*.html"):
        text = page.read_text("utf-8")
        if SHIM in text:
            page.write_text(text.replace(SHIM, os.path.relpath(target, page.parent)), "utf-8")
            changed += 1
    return changed


def pack(site: Path, out: Path) -> None:
    """Write the files of a site into a zip, below a folder of the zip's name."""
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed:
        for file in sorted(path for path in site.rglob("*") if path.is_file()):
            entry = zipfile.ZipInfo(f"{out.stem}/{file.relative_to(site).as_posix()}", DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            packed.writestr(entry, file.read_bytes())
