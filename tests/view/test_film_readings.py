"""Readings of single vehicles, read from a long log where they are asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.runs.small_run import COLUMNS, STEP, VEHICLES, append_chunk

from qrsim.runs import RunInfo, RunWriter, open_run
from qrsim.runs.parts import StreamParts
from qrsim.view import readings

# Ticks of a part, which are a second; and parts.
TICKS, PARTS = 50, 40


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of 40 s in 40 parts."""
    path = tmp_path_factory.mktemp("readings") / "run"
    info = RunInfo.collect(scenario="x", seed=1, precision="float64", time_step=STEP, vehicles=VEHICLES)
    with RunWriter.create(path, info=info, scenario_yaml="name: x\n", columns=COLUMNS) as writer:
        for number in range(PARTS):
            append_chunk(writer, number * TICKS, TICKS)
            writer.flush()
    return path


def test_only_the_parts_of_the_time_are_read(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(readings, "AHEAD_S", 2.0)
    found = readings.Excerpts(open_run(folder))
    read: list[int] = []
    plain = StreamParts._read_part
    monkeypatch.setattr(StreamParts, "_read_part", lambda self, *rest: (read.append(rest[0]), plain(self, *rest))[1])

    def check(time: float) -> int:
        """Compare three seconds of the second vehicle with what was written, and return how many parts were read."""
        read.clear()
        times, columns = found.of(1, "truth", time - 3.0, time)
        wanted = (times >= time - 3.0 - 1e-6) & (times <= time + 1e-6)
        ticks = np.arange(round((time - 3.0) / STEP), round(time / STEP) + 1)
        np.testing.assert_allclose(times[wanted], ticks * STEP)
        # Ten times the tick and the number of the vehicle, a thousand more for the second column.
        np.testing.assert_array_equal(columns["position_ned"][wanted], 1000.0 + 10.0 * ticks + 1.0)
        return len(read)

    # To find a time, as many parts are opened as halvings of forty; then those from 27 s to 32 s, twice.
    assert check(30.0) <= 6 + 2 * 6
    # What was read ahead is not read again, backwards and further on it is.
    assert check(31.5) == 0
    assert 0 < check(20.0) < 16
    assert 0 < check(39.0) < 16
    assert check(39.5) == 0


def test_a_few_vehicles_are_kept(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """So that browsers with choices of their own do not read in turns."""
    monkeypatch.setattr(readings, "MOST_KEPT", 2)
    found = readings.Excerpts(open_run(folder))
    first = [found.of(vehicle, "measurements", 0.0, 3.0) for vehicle in (0, 1)]
    assert [found.of(vehicle, "measurements", 1.0, 4.0)[0] is first[vehicle][0] for vehicle in (0, 1)] == [True, True]
    found.of(2, "measurements", 0.0, 3.0)
    # The one that was asked for longest ago is gone.
    assert found.of(1, "measurements", 0.0, 3.0)[0] is first[1][0]
    assert found.of(0, "measurements", 0.0, 3.0)[0] is not first[0][0]
