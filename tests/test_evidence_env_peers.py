"""The study of environments beside those of others, in its small form, and what the full form must have found."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from evidence import env_peers
from evidence.__main__ import plain

REPORT = Path(__file__).parents[1] / "docs" / "evidence" / "env_peers.json"


@pytest.mark.nightly
def test_the_small_form_counts_ours_and_says_where_a_step_goes(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("QRSIM_PEERS", str(tmp_path))
    found = plain(env_peers.run(full=False))
    assert set(found["compared"]) == {"envs_2"}
    assert set(found["compared"]["envs_2"]) == {"qrsim"}
    split = found["split"]
    parts = [split[name] for name in (*env_peers.PARTS, "rest")]
    assert sum(parts) == pytest.approx(1.0)
    # Episodes of random actions end soon, so that there is something of everything.
    assert all(part > 0.001 for part in parts)


def test_what_a_benchmark_prints_is_told_by_size_and_name() -> None:
    row = {"per_wall_second": 10.0, "per_cpu_second": 5.0, "ours_to_theirs": None, "num_envs": 4, "note": ""}
    found = env_peers.compared(
        [
            row | {"simulator": "qrsim"},
            row | {"simulator": "PyFlyt==0.29.0", "per_wall_second": 2.0, "ours_to_theirs": 5.0},
            row | {"simulator": "crazyflow==0.4.0", "per_wall_second": None, "note": "not installed"},
        ]
    )
    assert found == {
        "envs_4": {
            "qrsim": {"per_wall_second": 10.0, "per_cpu_second": 5.0},
            "pyflyt": {"per_wall_second": 2.0, "per_cpu_second": 5.0, "ours_to_theirs": 5.0},
        }
    }


def test_ours_make_three_times_the_steps_of_the_faster_one() -> None:
    """With one environment and with 1024, as the documentation says, with wind and sensors."""
    compared = json.loads(REPORT.read_text(encoding="utf-8"))["results"]["compared"]
    for size in ("envs_1", "envs_1024"):
        others = {name: row for name, row in compared[size].items() if name != "qrsim"}
        assert "crazyflow" in others
        assert all(row["ours_to_theirs"] > 3.0 for row in others.values())
