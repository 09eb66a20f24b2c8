"""The comparison of SLAM's solver with GTSAM's: its rows, and that GTSAM finds the same where it is installed."""

from __future__ import annotations

import json

import pytest
from evidence import slam_solver as study

ROW = {
    "problem": "poses, 900 s", "states": 4501, "ours_cpu_s": 2.0, "theirs_cpu_s": 1.0, "ours_to_theirs": 2.0,
    "ours_iterations": 12, "theirs_iterations": 7, "apart_m": 1e-6, "cost_apart": 0.0, "note": "ceres, identity",
}  # fmt: skip


def test_rows_become_numbers_by_problem():
    absent = dict.fromkeys(ROW) | {"problem": "linear, 120 s", "states": 601, "ours_cpu_s": 0.01, "note": "absent"}
    found = study.by_problem([ROW, absent])
    assert found == {
        "linear": {"flight_120_s": {"states": 601, "ours_cpu_s": 0.01}},
        "poses": {"flight_900_s": {key: value for key, value in ROW.items() if key not in ("problem", "note")}},
    }
    json.dumps(found, allow_nan=False)


@pytest.mark.nightly
def test_the_small_form():
    found = study.run(full=False)
    for name in ("linear", "poses"):
        row = found[name]["flight_4_s"]
        assert row["states"] == 21
        assert row["ours_cpu_s"] > 0.0
        if "theirs_cpu_s" in row:  # GTSAM is installed
            assert row["apart_m"] < 1e-4
