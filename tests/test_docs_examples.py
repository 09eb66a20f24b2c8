"""Every example in README.md and docs/ runs: Python blocks as they are, qrsim commands in a temporary folder."""

from __future__ import annotations

import re
import shlex
import sys
import types
from pathlib import Path
from typing import Any

import pytest

from qrsim import cli

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(language: str) -> list[tuple[str, str]]:
    """Return (page and number, text) of every fenced block of a language."""
    found = []
    for page in PAGES:
        matches = [text for kind, text in FENCE.findall(page.read_text("utf-8")) if kind == language]
        found += [(f"{page.name}-{number}", text) for number, text in enumerate(matches, start=1)]
    return found


def examples(language: str) -> list[Any]:
    """Return a case for every example; those beyond the README take long."""
    cases = []
    for name, text in blocks(language):
        marks = () if name.startswith("README") else (pytest.mark.long,)
        cases.append(pytest.param(name, text, id=name, marks=marks))
    return cases


def test_the_pages_have_examples() -> None:
    assert blocks("python")
    assert blocks("bash")


@pytest.mark.long
@pytest.mark.parametrize(("name", "text"), examples("python"))
def test_python_example(name: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # As somebody's file would be: a module that its classes are found in, and nothing inherited from this one.
    module = types.ModuleType("example")
    monkeypatch.setitem(sys.modules, "example", module)
    exec(compile(text, name, "exec", dont_inherit=True), module.__dict__)


@pytest.mark.long
@pytest.mark.parametrize(("name", "text"), examples("bash"))
def test_commands(name: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for line in text.splitlines():
        words = shlex.split(line, comments=True)
        if not words or words[0] == "make":
            continue
        assert words[0] == "qrsim", line
        assert cli.main(words[1:]) == 0, line


@pytest.mark.parametrize(("name", "text"), examples("yaml"))
def test_scenario_flies(name: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("example.yaml").write_text(text, "utf-8")
    assert cli.main(["run", "example.yaml", "--out", "flown", "--no-figure"]) == 0
