"""Differences of the settings of two runs: seed, versions, and the scenario value by value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from qrsim.runs.reader import Run

ABSENT = "(absent)"
INFO = ("seed", "precision", "every", "state", "ticks", "versions", "platform")


@dataclass(frozen=True)
class Setting:
    """A value that differs between two runs: its path, and each run's value or ``ABSENT``."""

    path: str
    values: tuple[object, object]


def setting_differences(first: Run, second: Run) -> list[Setting]:
    """Return the differing entries of two runs' run.json and scenarios; scenario paths begin with "scenario.".

    Raises:
        RunError: a scenario.yaml is no YAML.
    """
    runs = (first, second)
    infos = [{name: getattr(run.info, name) for name in INFO} for run in runs]
    scenarios = [{"scenario": _scenario(run)} for run in runs]
    return [*_differences("", *infos), *_differences("", *scenarios)]


def _scenario(run: Run) -> object:
    """Return the recorded scenario of a run as nested dicts and lists."""
    return run.scenario


def _differences(path: str, first: object, second: object) -> Iterator[Setting]:
    """Yield the differing entries of two nested structures at ``path``; a list of plain values counts as one."""
    mine, other = _children(first), _children(second)
    if mine is not None and other is not None:
        for key in dict.fromkeys([*mine, *other]):
            yield from _differences(f"{path}.{key}".removeprefix("."), mine.get(key, ABSENT), other.get(key, ABSENT))
    elif first != second:
        yield Setting(path, (first, second))


def _children(tree: object) -> Mapping[object, object] | None:
    """Return the children, by key or index, of a mapping or of a list with nested values; None for a leaf."""
    if isinstance(tree, Mapping):
        return tree
    if isinstance(tree, list) and any(isinstance(item, dict | list) for item in tree):
        return dict(enumerate(tree))
    return None
