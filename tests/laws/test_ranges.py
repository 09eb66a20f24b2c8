"""What scenarios may say: defaults and bounds of all parameters, as published in scenario_ranges.csv.

Files of users rely on them. Who changes one changes the format: a row of the table, and a line of the changelog.
"""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from qrsim.core.tree import field_info
from qrsim.scenarios import catalogue

TABLE = Path(__file__).with_name("scenario_ranges.csv")
COLUMNS = ("component", "parameter", "unit", "default", "minimum", "maximum", "above")


def _text(value: Any) -> str:
    return repr(value) if isinstance(value, int | float) and not isinstance(value, bool) else ""


def _rows(component: str, record: Any, prefix: str = "") -> Iterator[tuple[str, ...]]:
    """Yield a row for each number of a record, those of records in it by dotted names."""
    for field in dataclasses.fields(record):
        info, default = field_info(field), field.default
        if dataclasses.is_dataclass(default):
            yield from _rows(component, default, f"{prefix}{field.name}.")
            continue
        numbers = [_text(value) for value in (default, info.minimum, info.maximum, info.above)]
        if any(numbers):
            yield component, prefix + field.name, info.unit, *numbers


def found() -> list[tuple[str, ...]]:
    """Return the rows of all built-in components."""
    rows = []
    for kind, group in sorted(vars(catalogue).items()):
        if kind.isupper() and isinstance(group, dict):
            for name, component in sorted(group.items()):
                # What other tests have taken in from files is not built in.
                if ":" not in name and dataclasses.is_dataclass(component):
                    rows += list(_rows(f"{kind.lower()}/{name}", component))
    return rows


def test_defaults_and_bounds_are_the_published_ones() -> None:
    with TABLE.open(encoding="utf-8", newline="") as file:
        header, *published = (tuple(row) for row in csv.reader(file))
    assert header == COLUMNS
    assert len(published) > 600
    now = found()
    assert sorted(set(now) - set(published)) == [], "no such row in scenario_ranges.csv"
    assert sorted(set(published) - set(now)) == [], "a row of scenario_ranges.csv that holds no longer"
