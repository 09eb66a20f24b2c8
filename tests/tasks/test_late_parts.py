"""Parts of observations that are computed by themselves: the same numbers, and arrays that belong to the user."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from qrsim.envs.batch import Batch
from qrsim.envs.vector import VectorTask
from qrsim.tasks.search import Search

# Small pictures, whose programs are as large as those of large ones.
SMALL = [
    "fleets.helicopters.sensors.camera={type: camera, most_rows: 12, most_columns: 40}",
    "fleets.helicopters.vehicles.0.position_ned=[0, 0, -10]",
]


def flown() -> tuple[list[Any], list[Any]]:
    """Return what agents of three worlds see in six steps, and why they stopped; those of the first fall meanwhile."""
    batch = Batch("search_and_rescue/2D", 3, [*SMALL, "task.leave=true"])
    batch.reset([1, 2, 3])
    found, reasons, count = [batch.seen], [batch.truth["reason"].copy()], len(batch.functional.agents)
    for step in range(6):
        action = np.random.default_rng(step).uniform(-1.0, 1.0, (3, count, 3)).astype(np.float32)
        action[0] = (0.0, 0.0, 1.0)
        batch.step(action)
        found.append(batch.seen)
        reasons.append(batch.truth["reason"].copy())
    assert set(batch.episodes.late) == set(Search.later(batch.functional.play.task, batch.functional.play.world))
    found[-1] = {name: part.copy() for name, part in batch.seen.items()}
    batch.again(np.array([1]))
    return [*found, batch.seen], reasons


@pytest.mark.long
def test_parts_by_themselves_are_to_the_bit_those_with_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    alone, reasons = flown()
    monkeypatch.setattr(Search, "later", lambda self, world: {})
    together, _ = flown()
    assert [list(seen) for seen in alone] == [["corners", "grid", "ratio", "vehicle"]] * 8
    for mine, theirs in zip(alone, together, strict=True):
        for name in theirs:
            np.testing.assert_array_equal(mine[name], theirs[name])
    # An agent that has stopped sees what it saw last.
    stopped = reasons[-1] != 0
    assert stopped.any()
    assert not stopped.all()
    assert alone[-2]["ratio"][stopped].any(axis=(1, 2)).all()
    before = reasons[-2] != 0
    np.testing.assert_array_equal(alone[-3]["ratio"][before], alone[-2]["ratio"][before])


@pytest.mark.long
def test_a_user_may_change_what_an_environment_returned() -> None:
    """Two batches of the same seed, of which one has its observations overwritten at once."""
    both = [VectorTask("search_and_rescue/2B", 3, SMALL, autoreset_mode="DISABLED") for _ in range(2)]
    action = np.zeros((3, 3), np.float32)
    seen = [env.reset(seed=4)[0] for env in both]
    kept = {name: part.copy() for name, part in seen[0].items()}
    held = seen[0]
    for _ in range(2):
        for part in seen[1].values():
            part[...] = 7
        seen = [env.step(action)[0] for env in both]
    for name, part in held.items():
        np.testing.assert_array_equal(part, kept[name])
    for part in seen[1].values():
        part[...] = 7
    options: dict[str, Any] = {"reset_mask": np.array([False, True, False])}
    again = [env.reset(seed=[None, 9, None], options=options)[0] for env in both]
    for name in again[0]:
        np.testing.assert_array_equal(again[0][name], again[1][name])
        assert not np.shares_memory(again[0][name], seen[0][name])
    np.testing.assert_array_equal(again[0]["ratio"][0], seen[0]["ratio"][0])
    assert (again[0]["ratio"][1] != seen[0]["ratio"][1]).any()
