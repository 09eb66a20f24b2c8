"""Fixtures of the log tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from small_run import COLUMNS, STEP, VEHICLES

from qrsim.runs import RunInfo, RunWriter


@pytest.fixture
def info() -> RunInfo:
    return RunInfo.collect(
        scenario="two_fields",
        seed=7,
        precision="float32",
        time_step=STEP,
        vehicles=VEHICLES,
        command_line=["/somewhere/bin/qrsim", "run", "two fields"],
    )


@pytest.fixture
def start(tmp_path: Path, info: RunInfo) -> Callable[..., RunWriter]:
    """Return a function that creates a run in tmp_path / "run", which flushes only when told to."""

    def create(**options: Any) -> RunWriter:
        options = {"flush_rows": 10**9, "flush_seconds": 1e9, **options}
        folder = options.pop("folder", tmp_path / "run")
        return RunWriter.create(folder, info=info, scenario_yaml="name: two_fields\n", columns=COLUMNS, **options)

    return create
