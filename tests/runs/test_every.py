"""Decimated streams: which ticks are kept, and what summary and figure make of streams of different ticks."""

from __future__ import annotations

import numpy as np
import pytest
from flight import FIX_TICKS, GNSS_ERROR, SPEED, STEP, write_flight

from qrsim.errors import UsageError
from qrsim.runs import open_run
from qrsim.runs.figure import draw_run
from qrsim.runs.summary import common_rows, gnss_error, summarise

EVERY = {"truth": 5, "measurements": 2, "commands": 7}
TICKS = 60


@pytest.fixture
def run(tmp_path):
    return open_run(write_flight(tmp_path / "run", ticks=TICKS, every=EVERY))


def test_the_ticks_that_n_divides_are_kept_with_their_values(run, tmp_path):
    whole = open_run(write_flight(tmp_path / "whole", ticks=TICKS))
    assert run.info.every == EVERY
    for stream in ("truth", "measurements", "commands", "wind"):
        kept = np.arange(0, TICKS, EVERY.get(stream, 1))
        np.testing.assert_array_equal(run[stream].tick, kept)
        np.testing.assert_array_equal(run[stream].time, kept * STEP)
        assert run.table(stream).num_rows == 2 * len(kept)
        for name, values in whole[stream].arrays().items():
            np.testing.assert_array_equal(run[stream][name], values[kept])
    assert run.events == whole.events
    assert run.info.ticks == whole.info.ticks == TICKS - 1


def test_ticks_that_streams_have_in_common(run):
    true, measured = common_rows(run, "truth", "measurements")
    np.testing.assert_array_equal(run["truth"].tick[true], np.arange(0, TICKS, 10))
    np.testing.assert_array_equal(run["measurements"].tick[measured], np.arange(0, TICKS, 10))
    [alone] = common_rows(run, "truth")
    np.testing.assert_array_equal(run["truth"].tick[alone], np.arange(0, TICKS, 5))


def test_a_stream_that_was_cut_off_ends_the_others_and_a_decimated_one_does_not(tmp_path):
    killed = {"killed_after": ("truth",), "end": "running"}
    run = open_run(write_flight(tmp_path / "run", ticks=TICKS, every={"commands": 20}, **killed))
    # The other streams hold ticks up to 29, the commands 0 and 20; the truth went on.
    assert run["truth"].tick[-1] == TICKS - 1
    [rows] = common_rows(run, "truth")
    np.testing.assert_array_equal(run["truth"].tick[rows], np.arange(TICKS // 2))


def test_the_gnss_error_is_that_at_the_ticks_of_the_truth(tmp_path):
    # Fixes at 0, 10, ..., 50, the truth at 0, 15, 30, 45: compared where both are, so no age is added.
    run = open_run(write_flight(tmp_path / "run", ticks=TICKS, every={"truth": 15}))
    times, error = gnss_error(run)
    np.testing.assert_allclose(times, np.array([0, 30]) * STEP)
    np.testing.assert_allclose(error, np.broadcast_to(GNSS_ERROR, (2, 2, 3)), atol=1e-12)


def test_a_fix_that_is_seen_late_counts_with_its_age(tmp_path):
    # With every fourth tick of the measurements, the fix of tick 10 is first seen at 12, when the vehicle is further.
    run = open_run(write_flight(tmp_path / "run", ticks=TICKS // 2, every={"measurements": 4}))
    times, error = gnss_error(run)
    np.testing.assert_allclose(times, np.array([0, 12, 20]) * STEP)
    flown = SPEED * STEP * (12 - FIX_TICKS)
    np.testing.assert_allclose(error[1, 0], GNSS_ERROR - [flown, 0, 0], atol=1e-12)


def test_the_summary_of_decimated_streams(run, tmp_path):
    whole = summarise(open_run(write_flight(tmp_path / "whole", ticks=TICKS)))[0]
    thin = summarise(run)[0]
    # Straight legs with the corner at a tick that is kept: the path has its length, up to the last tick of the truth.
    assert thin.distance_m == pytest.approx(55 * SPEED * STEP)
    assert thin.gnss_horizontal_rms_m == pytest.approx(whole.gnss_horizontal_rms_m)
    assert thin.worst_wind_m_s == pytest.approx(whole.worst_wind_m_s)
    # The new leg, from tick 30 on, is first seen at tick 35, 0.2 m beside the old one.
    assert 0.0 <= thin.tracking_error_rms_m < 0.2
    assert thin.waypoints == whole.waypoints == 1


def test_the_figure_has_every_tick_that_was_logged(run):
    plan, height, wind, *gnss = draw_run(run).axes
    lengths = {len(line.get_xdata()) for line in height.lines}
    assert lengths == {12, 30, 9}
    assert {len(line.get_xdata()) for line in wind.lines} == {TICKS}
    # Beside the line at 0.
    assert [{len(line.get_xdata()) for line in axes.lines[1:]} for axes in gnss] == [{6}] * 3
    assert {
        len(line.get_xdata()) for line in plan.lines if line.get_linewidth() > 1 and line.get_marker() == "None"
    } == {12}


def test_only_the_first_tick_is_kept(tmp_path):
    run = open_run(write_flight(tmp_path / "run", ticks=TICKS, every=dict.fromkeys(EVERY, 1000)))
    np.testing.assert_array_equal(run["truth"].tick, [0])
    assert len(run["wind"].tick) == TICKS
    assert summarise(run)[0].distance_m == 0.0
    draw_run(run)


@pytest.mark.parametrize(
    ("every", "message"),
    [
        ({"trut": 2}, "no stream 'trut'; did you mean 'truth'"),
        ({"events": 2}, "'events' are all kept"),
        ({"truth": 0}, "stream 'truth': expected an integer from 1 to 2..31 - 1, got 0"),
        ({"truth": 2.5}, "expected an integer from 1 to 2..31 - 1, got 2.5"),
        ({"truth": True}, "expected an integer from 1 to 2..31 - 1, got True"),
        ({"truth": 2**31}, "expected an integer from 1 to 2..31 - 1, got 2147483648"),
    ],
)
def test_wrong_decimation(every, message, tmp_path):
    with pytest.raises(UsageError, match=message):
        write_flight(tmp_path / "run", every=every)
    assert not (tmp_path / "run").exists()
