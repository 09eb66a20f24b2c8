"""``qrsim run --every``: which ticks are logged, and that everything that reads a log works with them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from qrsim import cli
from qrsim.apps.run.every import parse_every
from qrsim.runs import open_run, recorder
from qrsim.runs.summary import summarise


@pytest.fixture(scope="module")
def thin(fly):
    """The flight of ``flown`` with fewer ticks in its log."""
    words = ("--seed", "3", "--duration", "10", "--every", "measurements=2", "--every", "20", "--every", "truth=5")
    return fly(*words, "--json")


def test_the_log_holds_the_ticks_that_were_asked_for(thin, flown):
    every = {"truth": 5, "measurements": 2, "commands": 20, "wind": 20}
    run, whole = open_run(thin.folder), open_run(flown.folder)
    assert thin.json["every"] == run.info.every == every
    for stream, number in every.items():
        np.testing.assert_array_equal(run[stream].tick, np.arange(0, 501, number))
        for name, values in whole[stream].arrays().items():
            np.testing.assert_array_equal(run[stream][name], values[::number], name)
    # What happens once is never lost.
    assert run.events == whole.events
    assert len(run.events) > 0
    sizes = [sum(part.stat().st_size for part in (r.folder / "wind").iterdir()) for r in (run, whole)]
    assert sizes[0] < sizes[1] / 4


def test_the_summary_is_near_that_of_every_tick(thin, flown):
    for few, many in zip(summarise(open_run(thin.folder)), summarise(open_run(flown.folder)), strict=True):
        # A path of fewer points is shorter, by little at 10 Hz; fixes come every 10 ticks, all of which are kept.
        assert 0.99 * many.distance_m < few.distance_m <= many.distance_m
        assert few.gnss_horizontal_rms_m == pytest.approx(many.gnss_horizontal_rms_m, rel=1e-12)
        assert few.gnss_vertical_rms_m == pytest.approx(many.gnss_vertical_rms_m, rel=1e-12)
        assert few.worst_wind_m_s <= many.worst_wind_m_s
        assert few.waypoints == many.waypoints


def test_readers_of_the_log(thin, flown, tmp_path, capsys):
    assert (thin.folder / "figure.png").exists()
    assert cli.main(["plot", str(thin.folder), "--panel", "truth.thrust", "-o", str(tmp_path / "x.png")]) == 0
    assert cli.main(["compare", str(thin.folder), str(flown.folder)]) == 1
    assert "truth: 101 common ticks, 400 only in B; 17 of 17 quantities equal" in capsys.readouterr().out


def test_exported_events_stand_where_the_vehicle_was_last_logged(thin, tmp_path, capsys):
    for form in ("csv", "geojson", "gpx", "kml", "mcap"):
        target = tmp_path / (form if form == "csv" else f"x.{form}")
        assert cli.main(["export", str(thin.folder), "--format", form, "--out", str(target)]) == 0
    capsys.readouterr()
    features = json.loads((tmp_path / "x.geojson").read_text())["features"]
    points = [item for item in features if "event" in json.dumps(item["properties"])]
    assert len(points) >= len(open_run(thin.folder).events)
    assert all(item["geometry"] for item in points)


def test_the_table_says_that_ticks_are_missing(fly):
    printed = fly("--duration", "1", "--no-figure", "--every", "wind=10").printed
    assert "logged every Nth tick: wind 10; the table covers these ticks" in printed
    assert "every" not in fly("--duration", "1", "--no-figure", "--every", "1").printed


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], {}),
        (["1"], {}),
        (["10"], dict.fromkeys(("truth", "measurements", "commands", "wind"), 10)),
        (["truth=1", "10"], {"measurements": 10, "commands": 10, "wind": 10}),
        (["wind=3", "truth=2"], {"truth": 2, "wind": 3}),
    ],
)
def test_words(words, expected):
    assert parse_every(words) == expected


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["trut=5"], "no stream 'trut'; did you mean 'truth'?"),
        (["events=5"], "'events' are all kept"),
        (["=5"], "no stream ''"),
        (["truth=0"], "--every truth=0: expected N or STREAM=N with an integer from 1"),
        (["-3"], "--every"),
        (["truth=2.5"], "--every truth=2.5: expected N or STREAM=N with an integer from 1"),
        (["9" * 50], "expected N or STREAM=N with an integer from 1 to 2**31 - 1"),
        (["truth=" + "9" * 5000], "expected N or STREAM=N with an integer from 1 to 2**31 - 1"),
        (["truth"], "--every truth: expected N or STREAM=N"),
        (["truth=2", "truth=3"], "--every truth=3: truth is given twice"),
        (["2", "3"], "--every 3: N for all streams is given twice"),
    ],
)
def test_wrong_words_are_told_before_anything_is_compiled(words, part, monkeypatch, tmp_path, capsys):
    def built(*arguments: Any, **options: Any) -> None:
        raise AssertionError("a simulation was made")

    monkeypatch.setattr(recorder, "Simulation", built)
    options = [word for item in words for word in ("--every", item)]
    assert cli.main(["run", *options, "--out", str(tmp_path / "run")]) == 2
    printed = capsys.readouterr()
    assert part in printed.err
    assert "Traceback" not in printed.err
    assert not (tmp_path / "run").exists()
