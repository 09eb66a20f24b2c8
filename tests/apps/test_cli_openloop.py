"""The command line itself, and ``qrsim openloop``: numbers, formats, and what each bad input is told."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from qrsim import cli
from qrsim.apps.openloop import command_file
from qrsim.errors import RunError

HEADER = "pitch,roll,throttle,yaw,battery"
HOVER_RAW = "0,0,2417.4,0,11"
HOVER_SI = "0,0,0.59,0,11"
STATE_NAMES = "step,px,py,pz,phi,theta,psi,u,v,w,p,q,r,thrust,ax,ay,az"


def write(folder: Path, *rows: str, header: str = HEADER, name: str = "commands.csv", end: str = "\n") -> Path:
    path = folder / name
    path.write_bytes((end.join([header, *rows]) + end).encode())
    return path


def openloop(path: Path, *options: str, units: str = "raw", output: str = "") -> int:
    output = output or str(path.with_name("states.csv"))
    return cli.main(["openloop", str(path), "--units", units, "-o", output, *options])


def read_states(path: Path) -> np.ndarray:
    assert path.read_text().splitlines()[0] == STATE_NAMES
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


def refused(capsys: pytest.CaptureFixture[str], code: int, *parts: str, expected: int = 2) -> None:
    """The exit code is as expected, and one error without a traceback holds every part."""
    printed = capsys.readouterr()
    assert code == expected
    assert printed.err.count("error: ") == 1
    assert "Traceback" not in printed.err
    for part in parts:
        assert part in printed.err


# ---------------------------------------------------------------- the command line


def test_help_lists_every_command(capsys):
    assert cli.main(["--help"]) == 0
    printed = capsys.readouterr().out
    for name in cli.COMMANDS:
        assert f"• {name}" in printed


def every_command() -> list[list[str]]:
    """The words that lead to each command."""
    found = []
    for name, entry in cli.COMMANDS.items():
        found += [[name, inner] for inner in entry.commands] if isinstance(entry, cli.Group) else [[name]]
    return found


@pytest.mark.parametrize("words", every_command(), ids=" ".join)
def test_every_command_has_an_example(words, capsys):
    assert cli.main([*words, "--help"]) == 0
    assert f"Example:\n  qrsim {' '.join(words)}" in capsys.readouterr().out


def test_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("qrsim 0.")
    assert cli.main(["version"]) == 0
    assert "jaxlib" in capsys.readouterr().out


def test_unknown_command_names_the_nearest(capsys):
    refused(capsys, cli.main(["openlop"]), "no such command 'openlop'", "did you mean 'openloop'?")
    refused(capsys, cli.main(["data", "fetsh"]), "qrsim data: no such command 'fetsh'", "did you mean 'fetch'?")


@pytest.mark.parametrize("words", [[], ["data"], ["--nonsense"], ["openloop"], ["openloop", "x.csv", "--unit", "raw"]])
def test_wrong_usage_exits_with_2(words, capsys):
    assert cli.main(words) == 2
    assert "--help" in capsys.readouterr().err


@dataclass
class Raises:
    """Stands in for a command."""

    error: ClassVar[BaseException] = RuntimeError()

    def run(self) -> None:
        raise self.error


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (RunError("disk full"), 1, "error: disk full"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (BrokenPipeError(), 141, ""),
        (ZeroDivisionError("oops"), 1, "this is a bug in qrsim: please report it"),
    ],
)
def test_exit_codes(error, code, text, monkeypatch, capsys):
    monkeypatch.setattr(Raises, "error", error)
    monkeypatch.setitem(cli.COMMANDS, "raises", Raises)
    assert cli.main(["raises"]) == code
    printed = capsys.readouterr().err
    assert text in printed
    # Only what qrsim did not mean to raise shows where it came from.
    assert ("Traceback" in printed) == isinstance(error, ZeroDivisionError)
    assert text or not printed


def test_help_imports_nothing_slow():
    slow = ("jax", "numpy", "pyarrow", "matplotlib", "scipy", "pydantic", "pooch", "rich")
    program = (
        "import sys, qrsim.cli; code = qrsim.cli.main(['--help']);"
        f" print([name for name in {slow!r} if name in sys.modules], file=sys.stderr); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.strip()) == (0, "[]")


# ---------------------------------------------------------------- numbers


def golden_errors(golden: Path, name: str, precision: str, output: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return |error| of each number of the 16 columns, and the golden numbers."""
    code = openloop(
        golden / name, "--wind-body=1,-0.5,0.2", "--precision", precision, "--vehicle", "pelican", output=str(output)
    )
    assert code == 0
    states = read_states(output)
    expected = np.loadtxt(golden / name, delimiter=",", skiprows=1)[:, [0, *range(6, 22)]]
    np.testing.assert_array_equal(states[:, 0], expected[:, 0])
    return np.abs(states[:, 1:] - expected[:, 1:]), expected[:, 1:]


@pytest.mark.long
@pytest.mark.parametrize("name", ["hover.csv", "varied.csv"])
def test_golden_in_double_precision(golden, name, tmp_path):
    errors, expected = golden_errors(golden, name, "float64", tmp_path / "states.csv")
    assert (errors <= 1e-9 * np.abs(expected)).all()


@pytest.mark.parametrize("name", ["hover.csv", "varied.csv"])
def test_golden_in_single_precision(golden, name, tmp_path):
    errors, expected = golden_errors(golden, name, "float32", tmp_path / "states.csv")
    # Relative to the largest number of each column: single numbers pass through zero.
    assert (errors <= 1e-4 * np.abs(expected).max(axis=0)).all()
    assert errors.max() > 0.0


def test_output_keeps_17_digits(tmp_path):
    from qrsim.models.vehicles.quadrotor import Quadrotor
    from qrsim.simulation.openloop import hover_state, simulate_open_loop

    path = write(tmp_path, *["0.1,-0.2,0.7,0.5,11.5"] * 3)
    assert openloop(path, units="si") == 0
    commands = np.tile([0.1, -0.2, 0.7, 0.5, 11.5], (3, 1))
    expected = simulate_open_loop(Quadrotor(), commands, hover_state(Quadrotor()))
    np.testing.assert_array_equal(read_states(tmp_path / "states.csv")[:, 1:], expected)


def test_raw_and_si_files_of_the_same_commands_agree(tmp_path):
    raw = write(tmp_path, *["400,-800,3000,900,11"] * 3, name="raw.csv")
    degree = np.pi / 180.0
    si = [-400 * 0.025 * degree, 800 * 0.025 * degree, 3000 / 4097, -900 * 254.760 / 2047 * degree, 11.0]
    row = ",".join(map(repr, map(float, si)))
    other = write(tmp_path, *[row] * 3, header="pitch,roll,throttle,yaw_rate,battery", name="si.csv")
    assert openloop(raw, output=str(tmp_path / "a.csv")) == 0
    assert openloop(other, units="si", output=str(tmp_path / "b.csv")) == 0
    a, b = read_states(tmp_path / "a.csv"), read_states(tmp_path / "b.csv")
    np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ("1,2,-3,0,0,0.5", [1, 2, -3, 0, 0, 0.5, 0, 0, 0, 0, 0, 0, 1.68 * 9.81]),
        ("-1,2,-3,0,0,0.5,4,5,6,0,0,0.1", [-1, 2, -3, 0, 0, 0.5, 4, 5, 6, 0, 0, 0.1, 1.68 * 9.81]),
        ("1,2,-3,0,0,0.5,4,5,6,0,0,0.1,12", [1, 2, -3, 0, 0, 0.5, 4, 5, 6, 0, 0, 0.1, 12]),
    ],
)
def test_initial_state(numbers, expected, tmp_path):
    """After a step of a picosecond the state is still the initial one."""
    path = write(tmp_path, *[HOVER_SI] * 3)
    assert openloop(path, f"--initial={numbers}", "--time-step", "1e-12", units="si") == 0
    np.testing.assert_allclose(read_states(tmp_path / "states.csv")[0, 1:14], expected, rtol=0, atol=1e-9)


def test_initial_state_default(tmp_path):
    path = write(tmp_path, *[HOVER_SI] * 3)
    assert openloop(path, "--time-step", "1e-12", units="si") == 0
    expected = [0, 0, -10, *[0] * 9, 1.68 * 9.81]
    np.testing.assert_allclose(read_states(tmp_path / "states.csv")[0, 1:14], expected, rtol=0, atol=1e-9)


def test_standard_output(tmp_path, capsys):
    path = write(tmp_path, HOVER_RAW, HOVER_RAW, HOVER_RAW)
    assert openloop(path) == 0
    assert capsys.readouterr().out.endswith("states.csv: 3 steps, 0.06 s\n")
    assert openloop(path, output="-") == 0
    assert capsys.readouterr().out == (tmp_path / "states.csv").read_text()


# ---------------------------------------------------------------- forms of the file


def test_extra_columns_are_said_once(tmp_path, capsys):
    header = "note,battery,yaw,throttle,roll,pitch,t"
    path = write(tmp_path, *["take-off,11,0,2417.4,0,0,nan"] * 3, header=header)
    assert openloop(path) == 0
    assert capsys.readouterr().err == f"note: {path}: columns not used: note, t\n"
    plain = write(tmp_path, *[HOVER_RAW] * 3, name="plain.csv")
    assert openloop(plain, output=str(tmp_path / "plain_states.csv")) == 0
    assert (tmp_path / "plain_states.csv").read_bytes() == (tmp_path / "states.csv").read_bytes()


@pytest.mark.parametrize("quoted", [False, True])
def test_forms_that_are_allowed(quoted, tmp_path):
    """Both readers take CRLF, a byte-order mark, spaces, a plus sign and blank lines at the end."""
    first = '"1.5", +2 ,.5,1e1,11.' if quoted else "1.5, 2 ,.5,1e1,11."
    path = write(tmp_path, first, HOVER_RAW, "", "", header="\ufeffpitch, roll,throttle,yaw,battery", end="\r\n")
    table = command_file.read_commands(path, "raw")
    np.testing.assert_array_equal(table.values, [[1.5, 2, 0.5, 10, 11], [0, 0, 2417.4, 0, 11]])
    np.testing.assert_array_equal(table.lines, [2, 3])


def test_a_quoted_line_end_keeps_the_line_numbers(tmp_path):
    path = write(tmp_path, '"two\nlines",' + HOVER_RAW, "one," + HOVER_RAW, header="note," + HEADER)
    np.testing.assert_array_equal(command_file.read_commands(path, "raw").lines, [2, 4])


def test_both_readers_agree(tmp_path):
    rng = np.random.default_rng(1)
    rows = [",".join(map(repr, row)) for row in rng.normal(scale=1e3, size=(2000, 5)).tolist()]
    fast = command_file.read_commands(write(tmp_path, *rows), "raw")
    slow = command_file.read_commands(write(tmp_path, '"0",0,0,0,0', *rows, name="quoted.csv"), "raw")
    np.testing.assert_array_equal(fast.values, slow.values[1:])
    np.testing.assert_array_equal(fast.lines + 1, slow.lines[1:])


# ---------------------------------------------------------------- bad files

BAD_ROWS = {
    "not a number": ("0,0,full,0,11", "line 4: column 'throttle' (column 3): 'full' is not a number"),
    "empty field": ("0,0,,0,11", "line 4: column 'throttle' (column 3): the field is empty"),
    "nan": ("0,NaN,2000,0,11", "line 4: column 'roll' (column 2): 'NaN' is not a finite number"),
    "inf": ("0,0,2000,-inf,11", "line 4: column 'yaw' (column 4): '-inf' is not a finite number"),
    "overflow": ("1e999,0,2000,0,11", "line 4: column 'pitch' (column 1): '1e999' is too large"),
    "underscore": ("1_0,0,2000,0,11", "line 4: column 'pitch' (column 1): '1_0' is not a number"),
    "hexadecimal": ("0x10,0,2000,0,11", "line 4: column 'pitch' (column 1): '0x10' is not a number"),
    "long text": ("x" * 999 + ",0,2000,0,11", "'" + "x" * 37 + "...' is not a number"),
    "too few fields": ("0,0,2000,0", "line 4: 4 fields, the header has 5"),
    "too many fields": ("0,0,2000,0,11,", "line 4: 6 fields, the header has 5"),
    "blank line": ("", "line 4: the line is empty"),
    "open quote": ('0,0,"2000,0,11', "line 4: not CSV: unexpected end of data"),
    "stray quote": ('0,0,"2000"x,0,11', "line 4: not CSV: "),
}


@pytest.mark.parametrize("case", BAD_ROWS)
def test_bad_row(case, tmp_path, capsys):
    row, message = BAD_ROWS[case]
    path = write(tmp_path, HOVER_RAW, HOVER_RAW, row, HOVER_RAW)
    refused(capsys, openloop(path), str(path), message)
    assert not (tmp_path / "states.csv").exists()


BAD_HEADERS = {
    "misspelt": ("pitch,roll,throtle,yaw,battery", "line 1: no column 'throttle'; did you mean 'throtle'?"),
    "none": (HOVER_RAW, "line 1: numbers where the names of the columns should be"),
    "twice": (
        HEADER + ",pitch",
        "the column 'pitch' is there more than once: 'pitch' (column 1) and 'pitch' (column 6)",
    ),
    "bars": (HEADER.replace(",", "|"), "the fields must be separated by commas, semicolons or tabs"),
    "semicolons": (HEADER.replace(",", ";"), "line 2: 1 field, the header has 5, separated by ';'"),
    "yaw_rate in raw": ("pitch,roll,throttle,yaw_rate,battery", "no column 'yaw'; 'yaw_rate' is SI"),
    "nothing near": ("a,b", "no column 'pitch'; known: a, b"),
    "stray quote": ('"pitch"x,roll', "line 1: not CSV"),
}


@pytest.mark.parametrize("case", BAD_HEADERS)
def test_bad_header(case, tmp_path, capsys):
    header, message = BAD_HEADERS[case]
    refused(capsys, openloop(write(tmp_path, HOVER_RAW, header=header)), message)


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_fields_between_semicolons_or_tabs_may_have_decimal_commas(delimiter, tmp_path, capsys):
    rows = ["0,5,2417.4,0,11", "0,-1.5,2417.4,0,11"]
    openloop(write(tmp_path, *rows))
    expected = read_states(tmp_path / "states.csv")
    for name, mark in (("points.csv", "."), ("commas.csv", ",")):
        changed = [row.replace(",", delimiter).replace(".", mark) for row in rows]
        path = write(tmp_path, *changed, header=HEADER.replace(",", delimiter), name=name)
        assert openloop(path, "--overwrite") == 0
        np.testing.assert_array_equal(read_states(tmp_path / "states.csv"), expected)


def test_yaw_twice_in_si(tmp_path, capsys):
    path = write(tmp_path, HOVER_SI + ",0", header=HEADER + ",yaw_rate")
    refused(capsys, openloop(path, units="si"), "the column 'yaw' is there more than once", "'yaw_rate' (column 6)")


def test_empty_files(tmp_path, capsys):
    path = tmp_path / "commands.csv"
    path.write_text(" \n\n")
    refused(capsys, openloop(path), "the file is empty", HEADER.replace(",", ", "))
    refused(capsys, openloop(write(tmp_path)), "no rows under the header")


def test_not_text(tmp_path, capsys):
    path = tmp_path / "commands.csv"
    path.write_bytes(f"{HEADER}\n{HOVER_RAW}\n0,0,\xff,0,11\n".encode("latin-1"))
    refused(capsys, openloop(path), "line 3: byte 0xff is not UTF-8 text")
    path.write_bytes(b"\xff\xfe" + HEADER.encode("utf-16le"))
    refused(capsys, openloop(path), "line 1: byte 0xff is not UTF-8 text")


def test_missing_file_names_the_nearest(tmp_path, capsys):
    write(tmp_path, HOVER_RAW)
    refused(capsys, openloop(tmp_path / "comands.csv"), "no such file; did you mean 'commands.csv'?")
    refused(capsys, openloop(tmp_path / "other" / "x.csv", output="-"), "x.csv: no such file")
    refused(capsys, openloop(tmp_path, output="-"), "cannot be read")


# ---------------------------------------------------------------- limits

# A row out of range, its units, and what must be said.
OUT_OF_RANGE = [
    ("0,0,5000,0,11", "raw", "line 3: column 'throttle': 5000 is outside 0 to 4097 (--units raw)"),
    ("-2100.5,0,0,0,11", "raw", "line 3: column 'pitch': -2100.5 is outside -2062.64 to 2062.64 (--units raw)"),
    ("0,0,0,2072,11", "raw", "line 3: column 'yaw': 2072 is outside -2071.67 to 2071.67 (--units raw)"),
    ("0,0,0,0,12.6", "raw", "line 3: column 'battery': 12.6 is outside 9 to 12 (--units raw)"),
    ("0,-0.91,0.5,0,11", "si", "line 3: column 'roll': -0.91 is outside -0.9 to 0.9 (--units si)"),
    ("0,0,0.5,4.6,11", "si", "line 3: column 'yaw': 4.6 is outside -4.5 to 4.5 (--units si)"),
    ("0,0,1.0000000000000002,0,11", "si", "line 3: column 'throttle': 1.0000000000000002 is outside 0 to 1"),
]


@pytest.mark.parametrize(("row", "units", "message"), OUT_OF_RANGE)
def test_out_of_range(row, units, message, tmp_path, capsys):
    path = write(tmp_path, "0,0,0.5,0,11", row, "0,0,0.5,0,11")
    refused(capsys, openloop(path, units=units), message, "--clip")
    assert openloop(path, "--clip", units=units) == 0
    assert f"note: {path}: 1 of 3 rows clipped, the first on line 3" in capsys.readouterr().err


@pytest.mark.parametrize("units", ["raw", "si"])
def test_the_bounds_that_messages_name_are_allowed(units, tmp_path):
    from qrsim.apps.openloop.units import limits_in, si_within_limits

    low, high = np.ceil(limits_in(units)[:, 0] * 100) / 100, np.floor(limits_in(units)[:, 1] * 100) / 100
    path = write(tmp_path, ",".join(map(str, low)), ",".join(map(str, high)))
    assert not si_within_limits(command_file.read_commands(path, units), units, clip=False)[1].any()


def test_clipped_run_is_the_run_at_the_bound(tmp_path):
    beyond = write(tmp_path, *["0.1,0,1.5,0,11"] * 3, name="beyond.csv")
    bound = write(tmp_path, *["0.1,0,1,0,11"] * 3, name="bound.csv")
    assert openloop(beyond, "--clip", units="si", output=str(tmp_path / "a.csv")) == 0
    assert openloop(bound, units="si", output=str(tmp_path / "b.csv")) == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


# ---------------------------------------------------------------- options


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--vehicle=pelikan", "--vehicle pelikan: no such vehicle; did you mean 'pelican'?"),
        ("--wind-body=1,2", "--wind-body=1,2: 2 numbers; expected 3 (u, v, w)"),
        ("--wind-body=1,x,3", "--wind-body=1,x,3: number 2, 'x', is not a finite number"),
        ("--wind-body=1,2,nan", "number 3, 'nan', is not a finite number"),
        ("--initial=1,2,3", "3 numbers; expected 6 (position, Euler angles), 12"),
        ("--initial=1,2,3,4,5,inf", "number 6, 'inf', is not a finite number"),
        ("--initial=", "number 1, '', is not a finite number"),
        ("--time-step=0", "--time-step 0.0: expected a positive number of seconds"),
        ("--time-step=nan", "--time-step nan: expected a positive number"),
    ],
)
def test_bad_option(option, message, tmp_path, capsys):
    refused(capsys, openloop(write(tmp_path, HOVER_RAW), option), message)


def test_units_are_required(tmp_path, capsys):
    path = write(tmp_path, HOVER_RAW)
    assert cli.main(["openloop", str(path), "-o", "-"]) == 2
    assert "--units {raw,si}" in capsys.readouterr().err
    assert cli.main(["openloop", str(path), "--units", "imperial", "-o", "-"]) == 2
    assert "imperial" in capsys.readouterr().err


def test_states_that_leave_the_finite_numbers(tmp_path, capsys):
    path = write(tmp_path, *["0.5,0,0.6,0,11"] * 400)
    code = openloop(path, "--time-step", "1", units="si")
    refused(capsys, code, "the state is not finite from step", f"of {path})", "--time-step", expected=1)
    assert not (tmp_path / "states.csv").exists()


# ---------------------------------------------------------------- the output file


def test_existing_output(tmp_path, capsys):
    path, output = write(tmp_path, *[HOVER_RAW] * 3), tmp_path / "states.csv"
    output.write_text("precious")
    refused(capsys, openloop(path), f"{output}: exists already; --overwrite replaces it")
    assert output.read_text() == "precious"
    assert openloop(path, "--overwrite") == 0
    assert output.read_text().startswith(STATE_NAMES)
    assert sorted(found.name for found in tmp_path.iterdir()) == ["commands.csv", "states.csv"]


def test_output_that_cannot_be(tmp_path, capsys):
    path = write(tmp_path, HOVER_RAW)
    refused(capsys, openloop(path, output=str(tmp_path / "no" / "s.csv")), "no does not exist")
    refused(capsys, openloop(path, output=str(tmp_path)), "is a folder")
    refused(capsys, openloop(path, "--overwrite", output=str(path)), "is the file of commands")
    assert path.read_text().startswith(HEADER)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_disk(tmp_path, capsys):
    path = write(tmp_path, *[HOVER_RAW] * 3)
    refused(capsys, openloop(path, output="/dev/full"), "/dev/full: cannot be written: No space left", expected=1)


@pytest.mark.skipif(os.name != "posix", reason="needs a shell")
@pytest.mark.long
def test_reader_that_goes_away(tmp_path):
    """As a process of its own: ``qrsim ... -o - | head -1`` says nothing on standard error."""
    path = write(tmp_path, *[HOVER_RAW] * 3000)
    line = f'set -o pipefail; "{sys.executable}" -m qrsim.cli openloop "{path}" --units raw -o - | head -1'
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (141, STATE_NAMES + "\n", "")
