"""``qrsim compare``: exit codes, what it prints, and the picture."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from qrsim import cli
from qrsim.runs import open_run
from qrsim.runs.summary import summarise


@pytest.fixture(scope="module")
def windier(fly):
    """Another seed, in more wind, for a shorter time and with a thinner log."""
    words = ("--seed", "4", "--duration", "5", "--set", "world.wind.speed_20ft=7", "--every", "truth=5")
    return fly(*words, "--no-figure").folder


def test_the_same_run_twice_is_bit_identical(flown, flown_again, capsys):
    assert cli.main(["compare", str(flown.folder), str(flown_again.folder)]) == 0
    printed = capsys.readouterr().out
    assert "Settings and scenario are the same." in printed
    assert "truth: 501 common ticks; 17 of 17 quantities equal" in printed
    assert printed.endswith("\nThe logs are bit-identical.\n")


def test_another_run_in_words(flown, windier, capsys):
    folders = (flown.folder, windier)
    assert cli.main(["compare", *map(str, folders)]) == 1
    printed = capsys.readouterr().out
    rows = [line.split() for line in printed.splitlines()]
    for row in (["seed", "3", "4"], ["scenario.world.wind.speed_20ft", "5.0", "7.0"], ["ticks", "500", "250"]):
        assert row in rows
    assert ["ended", "finished", "finished", "-"] in rows
    assert ["simulated", "time", "s", "10", "5", "-5"] in rows
    assert ["vehicles", "stopped", "0", "0", "0"] in rows
    [tracking] = [row for row in rows if row[:2] == ["tracking", "error,"]]
    errors = [math.sqrt(np.mean([row.tracking_error_rms_m**2 for row in summarise(open_run(f))])) for f in folders]
    assert [float(number) for number in tracking[4:6]] == pytest.approx(errors, rel=1e-3)
    assert "truth: 51 common ticks, 450 only in A; 1 of 17 quantities equal" in printed
    assert "wind: 251 common ticks, 250 only in A; 1 of 9 quantities equal" in printed
    [wind] = [row for row in rows if row[:1] == ["wind.mean_ned.x"]]
    assert wind[1:4] == ["m/s", "pelicans_0", "0"]
    assert len(wind) == 8
    assert "The logs differ, for the first time at 0 s in" in printed


def test_another_run_as_json_and_in_a_picture(flown, windier, tmp_path, capsys):
    target = tmp_path / "two.png"
    assert cli.main(["compare", str(flown.folder), str(windier), "--json", "--out", str(target)]) == 1
    result = json.loads(capsys.readouterr().out)
    assert (result["same"], result["bit_identical"], result["figure"]) == (False, False, str(target))
    assert {"path": "seed", "values": [3, 4]} in result["settings"]
    assert {"name": "simulated time", "unit": "s", "values": [10.0, 5.0]} in result["summary"]
    assert {"name": "energy", "unit": "Wh", "values": [None, None]} in result["summary"]
    by_name = {stream["stream"]: stream for stream in result["streams"]}
    assert (by_name["truth"]["ticks"], by_name["truth"]["ticks_only"]) == (51, [450, 0])
    times = [item["first"]["time_s"] for item in result["differences"]]
    assert times == sorted(times)
    [east] = [item for item in result["differences"] if item["quantity"] == "truth.position_ned.y"]
    assert 0 < east["rms_difference"] < east["largest_difference"]
    assert east["unit"] == "m"
    a, b = east["largest"]["values"]
    assert abs(a - b) == east["largest_difference"]
    assert target.read_bytes().startswith(b"\x89PNG")


def test_a_tolerance_and_a_stream_decide_the_exit_code(flown, fly):
    other = fly("--seed", "4", "--duration", "10", "--no-figure").folder
    words = ["compare", str(flown.folder), str(other), "--stream", "wind"]
    assert cli.main(words) == 1
    assert cli.main([*words, "--tolerance", "100"]) == 0


def test_small_differences_are_printed_with_the_digits_that_show_them():
    from qrsim.runs.compare_report import _values

    assert _values(1.0, 2.0) == ("1", "2")
    assert _values(1.66385555, 1.66385567) == ("1.66385555", "1.66385567")
    assert _values(float("nan"), 1.0) == ("-", "1")
    assert len(set(_values(1.0, 1.0 + 2**-52))) == 2


def test_a_damaged_part_is_left_out_with_a_warning(flown, tmp_path, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(flown.folder, copy)
    part = copy / "wind" / "part-00001.parquet"
    part.write_bytes(part.read_bytes()[:-20])
    assert cli.main(["compare", str(flown.folder), str(copy)]) == 1
    printed = capsys.readouterr()
    assert "left out: " in printed.err
    assert "only in A; 9 of 9 quantities equal" in printed.out
    assert "The logs record different quantities; all common values are equal." in printed.out


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--tolerance", "-1"], "--tolerance -1: expected a number from 0"),
        (["--tolerance", "nan"], "--tolerance nan: expected a number from 0"),
        (["--stream", "winds"], "neither run has a stream 'winds'; did you mean 'wind'?"),
        (["--out", "x.jpg"], "x.jpg: cannot draw '.jpg'; did you mean 'png'?"),
    ],
)
def test_wrong_usage(words, part, flown, refused):
    refused(["compare", str(flown.folder), str(flown.folder), *words], part)


def test_what_is_no_run(flown, tmp_path: Path, refused, capsys):
    refused(["compare", str(flown.folder), str(tmp_path)], f"{tmp_path} is not a run folder")
    assert cli.main(["compare", str(flown.folder)]) == 2
    assert "RUN_B" in capsys.readouterr().err
