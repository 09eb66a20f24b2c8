"""Print the notes of a release from CHANGELOG.md: ``python -m tools.release_notes v0.2.0``.

A tag without a section, with an empty one, or other than the version of pyproject.toml ends with exit code 1.
"""

from __future__ import annotations

import re
import sys

from tools.site import ROOT, version
from tools.site_source import turn


def notes(changes: str, version: str) -> str:
    """Return the section of a version, without its heading; "" without one.

    Args:
        changes: text of CHANGELOG.md.
        version: such as 0.2.0.
    """
    found = re.search(rf"^## \[{re.escape(version)}\][^\n]*\n(.*?)(?=^## |\Z)", changes, re.MULTILINE | re.DOTALL)
    return found[1].strip() if found else ""


def main(arguments: list[str]) -> int:
    """Print the notes of the tag that is named, and return an exit code."""
    if len(arguments) != 1 or not re.fullmatch(r"v\d+\.\d+\.\d+", arguments[0]):
        print("usage: python -m tools.release_notes vX.Y.Z", file=sys.stderr)
        return 2
    (tag,) = arguments
    text = notes((ROOT / "CHANGELOG.md").read_text("utf-8"), tag[1:])
    if tag != f"v{version()}" or not text:
        reason = f"pyproject.toml states {version()}" if tag != f"v{version()}" else "CHANGELOG.md has no entry of it"
        print(f"{tag}: {reason}", file=sys.stderr)
        return 1
    (repository,) = re.findall(r"^  repository: (\S+)$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.MULTILINE)
    print(turn(text, ROOT / "CHANGELOG.md", {}, ROOT, f"{repository}/blob/{tag}")[0])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
