"""A study small enough to be flown in each test."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.studies.sweep.killing import SMALL

from qrsim.studies.sweep.plan import Plan
from qrsim.studies.sweep.prepare import plan_of
from qrsim.studies.sweep.store import Store
from qrsim.studies.sweep.study import load_study
from qrsim.studies.sweep.sweeping import sweep_here


def write(folder: Path, **changes: Any) -> Path:
    """Write the study with changes; None takes a part out."""
    content = {name: value for name, value in {**SMALL, **changes}.items() if value is not None}
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def planned(folder: Path, **changes: Any) -> Plan:
    """Return the plan of the study with changes."""
    return plan_of(load_study(str(write(folder, **changes))))


def flown(folder: Path, name: str = "store.zarr", **changes: Any) -> Path:
    """Fly the study with changes in this process and return its store."""
    plan = planned(folder, **changes)
    store = Store(folder / name, plan)
    sweep_here(plan, store)
    store.close()
    return folder / name


@pytest.fixture
def study(tmp_path: Path) -> Callable[..., Path]:
    """A function that writes the study with changes and returns its path."""
    return lambda **changes: write(tmp_path, **changes)
