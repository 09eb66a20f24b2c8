"""Put the built site into the branch ``gh-pages``: ``python -m tools.publish_docs dev`` or ``release``.

Each version has a folder: ``dev``, or ``0.2`` for all of 0.2.*. ``latest`` is the newest release; the root leads to it.
``versions.json`` is what the selector of versions reads. Nothing is checked out, and nothing is pushed.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from tools import site

BRANCH = "gh-pages"
LATEST = "latest"
ROOT_PAGE = (
    '<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url={0}/"><a href="{0}/">{0}</a>\n'
)


def git(root: Path, *arguments: str, given: str = "", **environment: str) -> str:
    """Return what a git command prints, without the last line end."""
    done = subprocess.run(
        ["git", *arguments], cwd=root, env={**os.environ, **environment}, input=given, text=True, check=True,
        stdout=subprocess.PIPE,
    )  # fmt: skip
    return done.stdout.rstrip("\n")


def entries(root: Path, branch: str) -> dict[str, str]:
    """Return the entries of a branch's root, as mktree reads them, by name; none without the branch."""
    if not git(root, "for-each-ref", f"refs/heads/{branch}"):
        return {}
    lines = git(root, "ls-tree", f"refs/heads/{branch}").splitlines()
    return {line.split("\t", 1)[1]: line for line in lines}


def listed(old: str, version: str, title: str, latest: bool) -> str:
    """Return versions.json with a version: dev first, then the newest.

    Args:
        old: its content before, or "".
        version: folder of the version.
        title: what the selector shows.
        latest: whether the version is the newest release.
    """
    found = {each["version"]: each for each in json.loads(old or "[]") if each["version"] != version}
    if latest:
        found = {name: {**each, "aliases": []} for name, each in found.items()}
    found[version] = {"version": version, "title": title, "aliases": [LATEST] if latest else []}

    def newest_first(name: str) -> tuple[bool, list[int]]:
        return name == "dev", [int(part) for part in re.findall(r"\d+", name)]

    return json.dumps([found[name] for name in sorted(found, key=newest_first, reverse=True)], indent=1) + "\n"


def publish(root: Path, built: Path, version: str, title: str, latest: bool) -> str:
    """Commit a built site as a version, and return the commit.

    Args:
        root: the repository.
        built: folder of the built site.
        version: folder of the version on the branch.
        title: what the selector of versions shows.
        latest: whether the version is the newest release.
    """
    with tempfile.TemporaryDirectory() as folder:
        own = {"GIT_INDEX_FILE": str(Path(folder, "index")), "GIT_WORK_TREE": str(built), "GIT_DIR": _folder(root)}
        git(built, "add", "--all", "--force", ".", **own)
        tree = git(built, "write-tree", **own)
    found = entries(root, BRANCH)
    for name in (version, LATEST) if latest else (version,):
        found[name] = f"040000 tree {tree}\t{name}"
    old = git(root, "show", f"{BRANCH}:versions.json") if "versions.json" in found else ""
    files = {
        "versions.json": listed(old, version, title, latest),
        "index.html": ROOT_PAGE.format(LATEST if LATEST in found else version),
        ".nojekyll": "",
    }
    for name, text in files.items():
        found[name] = f"100644 blob {git(root, 'hash-object', '-w', '--stdin', given=text)}\t{name}"
    whole = git(root, "mktree", given="\n".join(found.values()) + "\n")
    parents = ["-p", BRANCH] if entries(root, BRANCH) else []
    commit = git(root, "commit-tree", whole, *parents, "-m", f"Publish the documentation of {title}")
    git(root, "update-ref", f"refs/heads/{BRANCH}", commit)
    return commit


def _folder(root: Path) -> str:
    return git(root, "rev-parse", "--absolute-git-dir")


def main(arguments: list[str]) -> int:
    """Build the site and commit it as ``dev`` or as the version of the package."""
    if arguments not in (["dev"], ["release"]):
        print("usage: python -m tools.publish_docs dev | release", file=sys.stderr)
        return 2
    if code := site.build("zensical"):
        return code
    number = site.version()
    release = arguments == ["release"]
    version = ".".join(number.split(".")[:2]) if release else "dev"
    publish(site.ROOT, site.ROOT / "build" / "site", version, number if release else "dev", release)
    print(f"committed {version} to {BRANCH}; publish it by 'git push origin {BRANCH}'")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
