"""``qrsim export --format rerun``: what is in the file."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.apps.test_cli_export import export, recorded, write_run  # noqa: F401

pytest.importorskip("rerun", reason="needs 'qrsim[rerun]'")


def test_a_file_has_every_series_and_vehicle(
    recorded: Path,  # noqa: F811
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "a.rrd"
    assert export(recorded, "rerun", "--out", str(path)) == 0
    assert "series" in capsys.readouterr().out
    data = path.read_bytes()
    # The head of rerun's files.
    assert data[:4] == b"RRF2"
    for entity in (b"/world/", b"/truth/", b"/map/", b"/events"):
        assert entity in data
    assert export(recorded, "rerun", "--out", str(path)) == 2
    assert "--force" in capsys.readouterr().err


def test_an_empty_run_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_run(tmp_path / "run", ticks=0)
    path = tmp_path / "a.rrd"
    assert export(folder, "rerun", "--out", str(path)) == 1
    assert "nothing to export" in capsys.readouterr().err
    assert [item.name for item in tmp_path.iterdir()] == ["run"]
