"""Pages of docs/reference/ that are written from the code: ``python -m tools.reference``.

Each module here makes pages, and has ``pages()``: a dict of file names below docs/reference/ and their Markdown.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "reference"
MODULES = (
    "command_line",
    "components",
    "scenario_schema",
    "presets",
    "log_columns",
    "environments",
    "errors",
    "environment_variables",
    "builtin",
    "mavlink",
)
NOTE = "<!-- Written by 'make docs-pages' from the code. Change it there. -->"


def made(module: str) -> Mapping[str, str]:
    """Return the pages of one module: file name -> Markdown."""
    pages: Mapping[str, str] = import_module(f"tools.reference.{module}").pages()
    return {name: f"{text.strip()}\n\n{NOTE}\n" for name, text in pages.items()}
