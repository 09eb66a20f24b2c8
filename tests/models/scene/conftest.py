"""One process with GDAL for the tests that ask for it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from qrsim.models.scene.terrain_files.gdal import Gdal


@pytest.fixture(scope="module")
def process() -> Iterator[Gdal]:
    with Gdal() as gdal:
        yield gdal


@pytest.fixture
def one_process(process: Gdal, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read with one process for all tests, because it takes a moment to start."""
    ask = Gdal._ask
    monkeypatch.setattr(Gdal, "_ask", lambda _, *request: ask(process, *request))
