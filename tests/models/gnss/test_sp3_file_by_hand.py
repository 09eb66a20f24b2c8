"""Limits of SP3 files, line by line after the formats of SP3-a and SP3-c (NGS)."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.errors import UsageError
from qrsim.models.gnss.sp3_file import read_sp3

HEAD = "#cP2010  8 31 15  0  0.00000000       2 ORBIT IGS05 HLM  IGS"
# 15:00 of this day, a Tuesday of GPS week 1599: 1599 weeks, two days and 15 hours.
FIRST = 1599 * 604800.0 + 2 * 86400.0 + 15 * 3600.0
Write = Callable[..., str]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_it(*lines: str) -> str:
        path = tmp_path / "orbits.sp3"
        path.write_text("\n".join([*lines, ""]))
        return str(path)

    return write_it


def epoch(minute: int = 0, second: float = 0.0, hour: int = 15) -> str:
    return f"*  2010  8 31 {hour:2} {minute:2} {second:11.8f}"


def place(x: float = 26000.0, clock: str = "") -> str:
    """Return a line of G05, x in columns 5 to 18, y and z to 46, the clock [us] in 47 to 60."""
    return f"PG05{x:14.6f}{0.0:14.6f}{0.0:14.6f}{clock:>14}"


def quarters(*lines: str) -> list[str]:
    """Return lines of G05, each at an epoch of its own, 15 minutes apart."""
    return [part for i, line in enumerate(lines) for part in (epoch(15 * i), line)]


def test_two_epochs_are_a_file(write: Write) -> None:
    found = read_sp3(write(HEAD, *quarters(place(), place(25000.0)), "EOF"))
    np.testing.assert_array_equal(found.gps_seconds, [FIRST, FIRST + 900.0])
    np.testing.assert_array_equal(found.positions_ecef, [[[26e6, 0.0, 0.0]], [[25e6, 0.0, 0.0]]])
    assert found.notes == ()


def test_columns_of_clock_and_manoeuvre(write: Write) -> None:
    """Clocks of 999999 us and more are none; an M in column 79 is a manoeuvre."""
    moved = f"{place(clock='-500000.000000'):<78}M"
    lines = [place(clock="999998.900000"), moved, place(clock="999999.000000")]
    found = read_sp3(write(HEAD, *quarters(*lines), "EOF"))
    np.testing.assert_allclose(found.clocks[:, 0], [0.9999989, -0.5, math.nan], rtol=1e-14)
    assert found.manoeuvre[:, 0].tolist() == [False, True, False]


@pytest.mark.parametrize("radius", [6401.0, 7000.0, 99999.0])
def test_satellites_fly_above_6400_km_and_below_100000(write: Write, radius: float) -> None:
    found = read_sp3(write(HEAD, *quarters(place(), place(-radius)), "EOF"))
    assert found.positions_ecef[1, 0, 0] == -1000.0 * radius


@pytest.mark.parametrize("radius", [6399.0, 100001.0, 119000.0])
def test_others_are_no_satellites(write: Write, radius: float) -> None:
    with pytest.raises(UsageError, match=r"line 5: G05 is .* km from the Earth's centre"):
        read_sp3(write(HEAD, *quarters(place(), place(radius)), "EOF"))


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ((HEAD,), "line 1: the file ends after no epoch"),
        (("#c",), "line 1: the file ends after no epoch"),
        (("#",), "line 1: '#' is not the start of an SP3 file"),
        ((HEAD, epoch(61), place()), "line 2: .* is no epoch"),
        ((HEAD, epoch(0, 61.0), place()), "line 2: .* is no epoch"),
        ((HEAD, epoch(0, 62.0), place()), "line 2: .* is no epoch"),
    ],
)
def test_the_shortest_bad_files(write: Write, lines: tuple[str, ...], expected: str) -> None:
    with pytest.raises(UsageError, match=expected):
        read_sp3(write(*lines))


def test_a_leap_second_is_a_time(write: Write) -> None:
    """The 61st second of a minute is one, and minute 60 is the next hour."""
    lines = [epoch(59, 60.0), place(), epoch(15, 0.0, 16), place(), epoch(30, 0.0, 16), place(), "EOF"]
    np.testing.assert_array_equal(read_sp3(write(HEAD, *lines)).gps_seconds, FIRST + 3600.0 + 900.0 * np.arange(3))


def test_a_single_epoch_that_is_missing_is_noted(write: Write) -> None:
    lines = [epoch(0), place(), epoch(15), place(), epoch(45), place(), "EOF"]
    (note,) = read_sp3(write(HEAD, *lines)).notes
    assert note.endswith("line 6: 1 epochs are missing between this one and line 4")


def test_epochs_may_miss_whole_seconds_by_a_tenth_of_a_microsecond(write: Write) -> None:
    """In double precision GPS seconds are known to 1.2e-7 s."""
    found = read_sp3(write(HEAD, epoch(0), place(), epoch(15, 1.2e-7), place(), "EOF"))
    assert found.interval == 900


def test_epochs_may_miss_the_grid_by_ten_microseconds(write: Write) -> None:
    def lines(late: float) -> list[Any]:
        return [HEAD, epoch(0), place(), epoch(15), place(), epoch(30, late), place(), "EOF"]

    assert read_sp3(write(*lines(9e-6))).interval == 900
    with pytest.raises(UsageError, match="line 6: epoch 2010-08-31 15:30:00 GPS is no multiple of 900 s"):
        read_sp3(write(*lines(1.1e-5)))
