"""Reading SP3 files: the recorded one and synthetic ones against georinex, and every bad input."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.models.gnss.sp3_writing import FIRST, NOMINAL, edit, line_of, names_of, sp3_text

from qrsim.errors import UsageError
from qrsim.models.gnss.sp3 import Sp3Ephemeris
from qrsim.models.gnss.sp3_file import read_sp3
from qrsim.models.site import GPS_EPOCH, utc_from_gps_seconds

Array = np.ndarray[Any, Any]
RECORDED = "ngs15992_16to17.sp3"


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], str]:
    def write_it(text: str) -> str:
        path = tmp_path / "orbits.sp3"
        path.write_text(text, encoding="latin-1")
        return str(path)

    return write_it


@pytest.fixture(scope="module")
def recorded(recordings: Path) -> Sp3Ephemeris:
    return Sp3Ephemeris(str(recordings / RECORDED))


# Reading


def georinex_numbers(path: str) -> tuple[list[str], Array, Array, Array]:
    """Names, GPS seconds, positions [m], clocks [s] as georinex reads them; it leaves a missing letter missing."""
    import georinex

    found = georinex.load(path)
    times = (found.time.values - np.datetime64(GPS_EPOCH.replace(tzinfo=None))) / np.timedelta64(1, "s")
    names = [str(name) if str(name)[0].isalpha() else f"G{int(name):02}" for name in found.sv.values]
    return names, times, 1000.0 * found.position.values, 1e-6 * found.clock.values


def test_georinex_reads_the_same_numbers(recordings: Path) -> None:
    path = str(recordings / RECORDED)
    names, times, positions, clocks = georinex_numbers(path)
    ours = read_sp3(path)
    assert list(ours.satellites) == names
    np.testing.assert_array_equal(ours.gps_seconds, times)
    np.testing.assert_array_equal(ours.positions_ecef, positions)
    np.testing.assert_array_equal(ours.clocks, clocks)
    assert (ours.notes, ours.gaps, ours.manoeuvre.any()) == ((), {}, np.False_)


def test_recorded_file(recorded: Sp3Ephemeris) -> None:
    """31 satellites without PRN 1, 20 epochs, times from the epoch lines; the header says 96 epochs and day 2, 0 h."""
    data = recorded.data
    assert (data.version, data.interval, data.positions_ecef.shape) == ("a", 900, (20, 31, 3))
    assert recorded.satellites == tuple(names_of("G", 32)[1:])
    assert recorded.span_gps_seconds == (FIRST, FIRST + 19 * 900.0)
    # 15 leap seconds in 2010: 15:00 GPS is 14:59:45 UTC.
    assert utc_from_gps_seconds(recorded.span_gps_seconds[0]) == datetime(2010, 8, 31, 14, 59, 45, tzinfo=UTC)
    np.testing.assert_allclose(data.positions_ecef[0, 0], [-15730536.190, 13454671.933, 16370778.232], rtol=1e-15)
    assert data.clocks[0, 0] == pytest.approx(285.005255e-6, abs=1e-15)


@pytest.mark.parametrize(
    ("version", "names"),
    [
        ("a", names_of("G")),
        ("c", names_of("G")),
        ("c", names_of("E", 10) + names_of("G") + names_of("R", 12)),
        ("d", names_of("C", 30) + names_of("E", 24) + names_of("G", 32) + names_of("J", 4) + names_of("R", 20)),
    ],
)
def test_files_of_each_version(write: Any, version: str, names: list[str]) -> None:
    path = write(sp3_text(version, names))
    ours = read_sp3(path)
    theirs, times, positions, clocks = georinex_numbers(path)
    assert list(ours.satellites) == theirs == names
    np.testing.assert_array_equal(ours.gps_seconds, times)
    np.testing.assert_array_equal(ours.positions_ecef, positions)
    np.testing.assert_array_equal(ours.clocks, clocks)
    assert ours.notes == ()
    truth = NOMINAL.positions_ecef(ours.gps_seconds)[:, np.arange(len(names)) % 24]
    # A file has millimetres; names is sorted as in the file.
    np.testing.assert_allclose(ours.positions_ecef, truth, rtol=0.0, atol=6e-4)


def test_records_that_do_not_matter_are_passed_over(write: Any) -> None:
    text = sp3_text()
    extended = []
    for line in text.splitlines():
        extended.append(line)
        if line.startswith("P"):
            extended += [
                "EP  55   55   55     222  1234567 -1234567  5999999      -30      215 -1230000",
                "V" + line[1:],
                "EV  22   22   22     111  1234567  1234567  1234567  1234567  1234567  1234567",
            ]
        if line.startswith("*"):
            extended.append("/* a comment among the epochs")
    extended += ["", "PG01 nothing after EOF counts"]
    plain, full = read_sp3(write(text)), read_sp3(write("\r\n".join(extended)))
    np.testing.assert_array_equal(full.positions_ecef, plain.positions_ecef)
    np.testing.assert_array_equal(full.clocks, plain.clocks)
    assert full.notes == ()


@pytest.mark.parametrize(
    ("system", "shift_s"),
    [("GPS", 0.0), ("GAL", 0.0), ("QZS", 0.0), ("TAI", -19.0), ("BDT", 14.0), ("UTC", 15.0), ("ccc", 0.0)],
)
def test_time_systems(write: Any, system: str, shift_s: float) -> None:
    """GPS time is TAI - 19 s, BeiDou's + 14 s, and in 2010 UTC + 15 s."""
    ephemeris = Sp3Ephemeris(write(sp3_text(time_system=system, shift_s=shift_s)))
    assert ephemeris.span_gps_seconds[0] == FIRST + shift_s
    middle = FIRST + shift_s + 9.4 * 900.0
    np.testing.assert_allclose(ephemeris.positions_ecef(middle), NOMINAL.positions_ecef(middle), rtol=0.0, atol=2e-3)


def test_letters_are_optional_and_the_order_is_free(write: Any) -> None:
    text = sp3_text("a", names_of("G"))
    bare = text.replace("PG0", "P  ").replace("PG", "P ")
    lines = bare.splitlines()
    first = line_of(bare, "*")
    lines[first : first + 24] = lines[first : first + 24][::-1]
    ours, plain = read_sp3(write("\n".join(lines))), read_sp3(write(text))
    assert ours.satellites == plain.satellites
    np.testing.assert_array_equal(ours.positions_ecef, plain.positions_ecef)


def test_missing_values(write: Any) -> None:
    text = sp3_text()
    bad = line_of(text, "PG05", 3)
    text = edit(text, bad, lambda line: f"{line[:4]}{0:14.6f}{0:14.6f}{0:14.6f}{999999.999999:14.6f}")
    text = edit(text, line_of(text, "PG06", 4), lambda line: line[:46])
    text = edit(text, line_of(text, "PG07", 5), lambda line: line[:46] + " 999999.      ")
    ours = read_sp3(write(text))
    assert [tuple(where) for where in np.argwhere(np.isnan(ours.positions_ecef[..., 0]))] == [(3, 4)]
    assert sorted(tuple(where) for where in np.argwhere(np.isnan(ours.clocks))) == [(3, 4), (4, 5), (5, 6)]
    assert list(ours.gaps) == ["G05"]
    assert ours.gaps["G05"].endswith(
        f"orbits.sp3: G05 has no position at 1 of 20 epochs, first 2010-08-31 15:45:00 GPS, line {bad}"
    )


def test_missing_lines_and_epochs_are_recorded(write: Any) -> None:
    text = sp3_text()
    epoch = line_of(text, "*", 7)
    text = edit(text, line_of(text, "PG11", 7), lambda _: None)
    # The whole of epochs 12 and 13.
    lines = text.splitlines()
    low, high = line_of(text, "*", 12), line_of(text, "*", 14)
    text = "\n".join([*lines[: low - 1], *lines[high - 1 :], ""])
    ours = read_sp3(write(text))
    assert ours.positions_ecef.shape == (20, 24, 3)
    assert np.isnan(ours.positions_ecef[12:14]).all()
    assert np.isnan(ours.positions_ecef[7, 10]).all()
    assert f"line {low}: 2 epochs are missing between this one and line {line_of(text, '*', 11)}" in ours.notes[0]
    assert f"G11 has no position at 1 of 18 epochs, first 2010-08-31 16:45:00 GPS, line {epoch}" in ours.gaps["G11"]


def test_a_file_without_its_end_is_noted(write: Any) -> None:
    text = sp3_text().replace("EOF\n", "")
    (note,) = read_sp3(write(text)).notes
    assert note.endswith(f"no EOF line; the file may be cut off after line {len(text.splitlines())}")


# Bad files: what is done to a good one, the line the error names (None: any), and words of its message.

TEXT = sp3_text()
FIFTH = line_of(TEXT, "PG05", 2)
EPOCH = line_of(TEXT, "*", 5)


def replaced(number: int, old: str, new: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert old in text.splitlines()[number - 1]
        return edit(text, number, lambda line: line.replace(old, new))

    return change


BAD: dict[str, tuple[Callable[[str], str], int | None, str]] = {
    "empty": (lambda _: "", 1, "'' is not the start of an SP3 file"),
    "another format": (
        lambda _: "     3.04           N: GNSS NAV DATA\n", 1, "'     3.04 .*' is not the start of an SP3 file",
    ),
    "version b": (lambda text: "#b" + text[2:], 1, "SP3 version 'b' is not supported; supported: a, c, d"),
    "no epochs": (lambda text: text[: text.index("\n*") + 1], EPOCH - 5 * 25 - 1, "the file ends after no epoch"),
    "one epoch": (
        lambda text: "\n".join(text.splitlines()[: line_of(text, "*", 1) - 1]), line_of(TEXT, "*", 1) - 1,
        "the file ends after one epoch",
    ),
    "cut off in a position": (lambda text: text[: text.index("PG05", 9000) + 30], None, "G05 is cut off at column 30"),
    "cut off in z": (lambda text: edit(text, FIFTH, lambda line: line[:44]), FIFTH, "G05 is cut off at column 44"),
    "cut off in a clock": (
        lambda text: edit(text, FIFTH, lambda line: line[:46] + "    1..4"), FIFTH, "clock of G05 in columns 47 to 60",
    ),
    "cut off in an epoch": (lambda text: edit(text, EPOCH, lambda line: line[:16]), EPOCH, "is no epoch; expected '"),
    "damaged number": (
        lambda text: edit(text, FIFTH, lambda line: line[:20] + "x" + line[21:]), FIFTH, "y of G05 in columns 19 to 32",
    ),
    "not a number": (
        lambda text: edit(text, FIFTH, lambda line: line[:4] + f"{math.nan:14.6f}" + line[18:]), FIFTH,
        "x of G05 in columns 5 to 18 is no number: 'nan'",
    ),
    "inside the Earth": (
        lambda text: edit(text, FIFTH, lambda line: f"{line[:4]}{4.0:14.6f}{3.0:14.6f}{0.0:14.6f}{line[46:]}"), FIFTH,
        "G05 is 5 km from the Earth's centre; expected 6400 to 100000 km",
    ),
    "no such satellite": (replaced(FIFTH, "PG05", "PX05"), FIFTH, "'X05' is no satellite; .* G, R, E, C, J, I, S, L"),
    "no number": (replaced(FIFTH, "PG05", "PG  "), FIFTH, "'G  ' is no satellite"),
    "satellite twice": (replaced(FIFTH, "PG05", "PG04"), FIFTH, f"G04 has a position .* already, in line {FIFTH - 1}"),
    "no such month": (replaced(EPOCH, " 08 ", " 13 "), EPOCH, "is no epoch"),
    "a year that no calendar has": (replaced(EPOCH, "2010", "9" * 30), EPOCH, "is no epoch"),
    "the last year of all": (replaced(EPOCH, "2010 08 31", "9999 12 31"), EPOCH, "is no epoch"),
    "a century later": (
        replaced(line_of(TEXT, "*", 19), "2010", "2110"), line_of(TEXT, "*", 19),
        "epoch 2110-.* is 350[0-9]{4} times 900 s, .*; allowed: 100000 epochs",
    ),
    "a number that is no digit": (replaced(FIFTH, "PG05", "PG0\u00b2"), FIFTH, "'G0.' is no satellite"),
    "no such hour": (replaced(EPOCH, " 16 ", " 25 "), EPOCH, "is no epoch"),
    "epoch twice": (
        replaced(EPOCH, " 16 15 ", " 16 00 "), EPOCH,
        f"epoch 2010-08-31 16:00:00 GPS repeats that of line {EPOCH - 25}",
    ),
    "epochs go back": (
        replaced(EPOCH, " 16 15 ", " 15 55 "), EPOCH,
        f"epoch 2010-08-31 15:55:00 GPS is before that of line {EPOCH - 25}",
    ),
    "uneven epochs": (
        replaced(EPOCH, " 16 15 ", " 16 10 "), EPOCH, "epoch 2010-08-31 16:10:00 GPS is no multiple of 900 s",
    ),
    "half seconds": (lambda _: sp3_text(interval=0.5), None, "epochs are 0.5 s apart; expected a whole number"),
    "time system": (
        replaced(line_of(TEXT, "%c"), "GPS", "ABC"), line_of(TEXT, "%c"),
        "time system 'ABC' is not known; known: GPS, GAL, .*, UTC, GLO",
    ),
    "a line of something else": (lambda text: edit(text, FIFTH, lambda _: "nonsense"), FIFTH, "'nonsense' is no SP3"),
    "a position before the epochs": (
        lambda text: edit(text, EPOCH - 5 * 25 - 1, lambda _: TEXT.splitlines()[FIFTH - 1]), EPOCH - 5 * 25 - 1,
        "a position line before the first epoch",
    ),
    "no positions": (
        lambda text: "\n".join(line for line in text.splitlines() if not line.startswith("P")), EPOCH - 5 * 25,
        "no satellite has a position line",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", BAD)
def test_bad_files(write: Any, fault: str) -> None:
    spoil, number, words = BAD[fault]
    path = write(spoil(TEXT))
    with pytest.raises(UsageError, match=words) as raised:
        read_sp3(path)
    assert str(raised.value).startswith(f"{path}, line {'' if number is None else number}")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere\.sp3: cannot be read: No such file or directory$"):
        read_sp3(tmp_path / "nowhere.sp3")
    (tmp_path / "somewhere.sp3").write_text("")
    with pytest.raises(UsageError, match=r"nowhere\.sp3: cannot .*; did you mean 'somewhere\.sp3'\?$"):
        read_sp3(tmp_path / "nowhere.sp3")
    with pytest.raises(UsageError, match="cannot be read: Is a directory"):
        read_sp3(tmp_path)
    packed = tmp_path / "orbits.sp3.gz"
    packed.write_bytes(b"\x1f\x8b\x08\x00")
    with pytest.raises(UsageError, match=r"orbits\.sp3\.gz: is compressed; unpack it first"):
        read_sp3(packed)
