"""Build or serve the documentation site: ``python -m tools.site build``, ``serve`` and ``zip``.

``build`` is strict: a link to a missing page or anchor, a page without a place in the navigation, an equation that is
not LaTeX and a warning about a docstring each end it with exit code 1. ``zip`` writes a site whose pages are opened as
files.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path

from tools import equations, offline_site
from tools.site_source import BrokenLinkError, collect, pages

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "build" / "site-source"
# Of griffe and mkdocstrings, which do not end the build of Zensical by themselves.
WARNINGS = ("WARNING", "Warning:", "griffe:")


def version() -> str:
    """Return the version that pyproject.toml states, whichever is installed."""
    return str(tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"])


def address() -> str:
    """Return the address of the repository's files at the tag of this version."""
    lines = (ROOT / "mkdocs.yml").read_text("utf-8").splitlines()
    (repository,) = (line.split(": ", 1)[1] for line in lines if line.startswith("  repository: "))
    return f"{repository.rstrip('/')}/blob/v{version()}"


def without_a_place() -> list[str]:
    """Return the pages that the navigation of mkdocs.yml does not name."""
    navigation = (ROOT / "mkdocs.yml").read_text("utf-8").split("\nnav:\n", 1)[1]
    named = {line.split(": ", 1)[-1].removeprefix("- ").strip() for line in navigation.splitlines()}
    return [name for name in pages(ROOT).values() if name.endswith(".md") and name not in named]


def wrong_equations(root: Path) -> list[str]:
    """Return page, line and fault of the equations that cannot be drawn."""
    each = [path for path in pages(root) if path.suffix == ".md"]
    return [f"{path.relative_to(root)}:{fault}" for path in each for fault in equations.faults(path.read_text("utf-8"))]


def build(program: str, file: str = "mkdocs.yml") -> int:
    """Build the site into the folder that a configuration file names, and return an exit code."""
    if lost := without_a_place():
        print(f"mkdocs.yml: no entry under nav for {', '.join(lost)}", file=sys.stderr)
        return 1
    if wrong := wrong_equations(ROOT):
        print(*wrong, sep="\n", file=sys.stderr)
        return 1
    print(f"{collect(ROOT, SOURCE, address())} links to files of the repository", flush=True)
    command = [sys.executable, "-m", program, "build", "--strict", "--clean", "-f", file]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )
    output = re.sub("\x1b\\[[0-9;]*m", "", done.stdout)  # Zensical colours it for files too
    print(output, end="")
    warned = [line for line in output.splitlines() if line.lstrip().startswith(WARNINGS)]
    if warned:
        print(f"{len(warned)} warnings", file=sys.stderr)
    return 1 if warned or done.returncode else 0


def pack() -> int:
    """Write the site for reading without a server into build/qrsim-docs-VERSION.zip, and return an exit code."""
    # Paths of a configuration are relative to its folder, and the site may not leave that.
    file, folder = ROOT / ".mkdocs-offline.yml", ROOT / "build" / "site-offline"
    try:
        file.write_text(offline_site.configuration((ROOT / "mkdocs.yml").read_text("utf-8")), "utf-8")
        if code := build("zensical", file.name):
            return code
    finally:
        file.unlink()
    if not offline_site.complete(folder):
        print("no page loads the shim of workers: search would not work from files", file=sys.stderr)
        return 1
    out = ROOT / "build" / f"qrsim-docs-{version()}.zip"
    offline_site.pack(folder, out)
    print(f"wrote {out.relative_to(ROOT)}, {out.stat().st_size / 1e6:.0f} MB")
    return 0


def serve() -> int:
    """Serve the site, collecting pages again every second, until interrupted."""
    collect(ROOT, SOURCE, address())
    threading.Thread(target=_follow, daemon=True).start()
    return subprocess.run([sys.executable, "-m", "zensical", "serve"], cwd=ROOT, check=False).returncode


def _follow() -> None:
    while True:
        time.sleep(1.0)
        try:
            collect(ROOT, SOURCE, address())
        except BrokenLinkError as error:
            print(error, file=sys.stderr)


def main(arguments: list[str]) -> int:
    """Run one of the commands; ``build mkdocs`` uses Material for MkDocs, the fall-back."""
    try:
        if arguments in (["build"], ["build", "mkdocs"]):
            return build(arguments[1] if arguments[1:] else "zensical")
        if arguments == ["serve"]:
            return serve()
        if arguments == ["zip"]:
            return pack()
    except BrokenLinkError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    print("usage: python -m tools.site build | build mkdocs | serve | zip", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
