"""Every reader gives back what was logged, and says what is wrong with a log."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.studies.flight_logs.log_writing import DT, Floats, flown, write_csv, write_dataflash, write_ulog
from tests.wrong_input.logs import ulog
from tests.wrong_input.mutating import mutated

from qrsim.errors import LogError, UsageError
from qrsim.studies.flight_logs import SIGNALS, FlightLog, read_log, ulog_messages
from qrsim.studies.flight_logs.inertial import read_inertial

WRITERS: dict[str, Callable[..., Path]] = {"log.csv": write_csv, "log.ulg": write_ulog, "log.bin": write_dataflash}


@pytest.fixture(scope="module")
def signals() -> dict[str, Floats]:
    return flown()


def said(log: FlightLog, text: str) -> bool:
    return any(text in note for note in log.notes)


@pytest.mark.parametrize("name", WRITERS)
def test_what_was_logged_is_read(name: str, signals: dict[str, Floats], tmp_path: Path) -> None:
    log = read_log(WRITERS[name](tmp_path / name, signals))
    assert set(log.signals) == set(SIGNALS) - {"thrust"}
    assert log.dt == DT
    rows = len(log.time)
    assert rows > len(signals["time"]) - 15
    for key, values in log.signals.items():
        expected = signals[key][:rows]
        # Velocities in between are interpolated; a command that a rounded time puts a row later differs for that row.
        close = np.isclose(values, expected, atol=0.05 if "velocity" in key and name == "log.ulg" else 2e-3)
        assert close.mean() > 0.97, key


def test_an_old_ulog_has_its_rates_with_the_attitude(signals: dict[str, Floats], tmp_path: Path) -> None:
    log = read_log(write_ulog(tmp_path / "log.ulg", signals, old=True))
    assert set(log.signals) == set(SIGNALS) - {"thrust"}
    for name in ("roll_rate", "pitch_rate", "yaw_rate", "throttle"):
        assert np.isclose(log.signals[name], signals[name][: len(log.time)], atol=2e-3).mean() > 0.97, name
    assert log.rates["velocity_down"] == pytest.approx(25.0)
    assert log.rates["battery"] == pytest.approx(5.0)


def test_units_of_a_table(signals: dict[str, Floats], tmp_path: Path) -> None:
    units = {
        "time": ("ms", 1e3),
        "roll": ("deg", 180 / np.pi),
        "velocity_north": ("km/h", 3.6),
        "battery": ("mV", 1e3),
        "throttle": ("%", 100.0),
        "pitch_command": ("raw", -1 / np.radians(0.025)),
    }
    log = read_log(write_csv(tmp_path / "log.csv", signals, units))
    for name in ("roll", "velocity_north", "battery", "throttle", "pitch_command"):
        assert np.allclose(log.signals[name], signals[name][: len(log.time)], atol=1e-6), name


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_a_table_of_a_country_with_decimal_commas(delimiter: str, signals: dict[str, Floats], tmp_path: Path) -> None:
    plain = write_csv(tmp_path / "plain.csv", signals)
    path = tmp_path / "log.csv"
    text = plain.read_text().replace(",", delimiter).replace(".", ",")
    path.write_text(text, encoding="utf-8-sig", newline="\r\n")
    log, expected = read_log(path), read_log(plain)
    for name, values in expected.signals.items():
        np.testing.assert_array_equal(log.signals[name], values)


def test_readings_of_an_imu_with_decimal_commas(tmp_path: Path) -> None:
    rows = [f"{i / 100:.2f};0.25;-1.5;2e-1" for i in range(100)]
    path = tmp_path / "imu.csv"
    path.write_text(
        "time [s];gyroscope_x [rad/s];gyroscope_y [rad/s];gyroscope_z [rad/s]\n" + "\n".join(rows).replace(".", ",")
    )
    found = read_inertial(path)
    assert found.period == pytest.approx(0.01)
    assert found.values["gyroscope"].tolist() == [[0.25, -1.5, 0.2]] * 100


@pytest.mark.parametrize(
    ("header", "parts"),
    [
        ("time [s],roll", ("'roll' has no unit", "roll [rad]")),
        ("time [s],roll [degs]", ("roll [degs]", "did you mean 'deg'")),
        ("roll [rad],pitch [rad]", ("no column 'time [s]'", "pitch [rad]")),
        ("time [s],roll [rad],roll [deg]", ("'roll' is there twice",)),
        ("time [s],rol [rad]", ("no column of a vehicle", "rol [rad]", "roll,")),
        ("time [s],roll [rad],x", ("line 2: 2 fields, the header has 3",)),
    ],
)
def test_a_wrong_header(header: str, parts: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(header + "\n0,1\n")
    with pytest.raises(UsageError) as error:
        read_log(path)
    for part in (str(path), *parts):
        assert part in str(error.value)


def test_no_number_and_no_file(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    for content, part in (
        ("time [s],roll [rad]\n0,abc\n", "line 2: column 'roll [rad]': 'abc' is not a number"),
        ("", "the file is empty"),
        ("1,2,3\n1,2,3\n", "numbers without a header, 3 columns"),
        ("a\0b", "neither ULog nor DataFlash nor text"),
        ("1,2,3,4\n1,2\n", "neither a header with names nor numbers only"),
    ):
        path.write_text(content)
        with pytest.raises(UsageError, match=r"log\.csv") as error:
            read_log(path)
        assert part in str(error.value)
    with pytest.raises(UsageError, match=r"no such file; did you mean 'log\.csv'"):
        read_log(tmp_path / "logs.csv")


def test_suspect_units(signals: dict[str, Floats], tmp_path: Path) -> None:
    for name, factor, guess in (
        ("roll", 60.0, "degrees"),
        ("throttle", 100.0, "per cent"),
        ("battery", 1e3, "millivolts"),
    ):
        path = write_csv(tmp_path / "log.csv", signals | {name: signals[name] * factor})
        with pytest.raises(UsageError, match=f"{name}: its unit is suspect") as error:
            read_log(path)
        assert f"is it in {guess}" in str(error.value)


@pytest.mark.long
def test_too_short(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"too short: its signals have 1\.98 s in common"):
        read_log(write_csv(tmp_path / "log.csv", flown(2.0)))


def test_what_is_no_number_or_twice_or_out_of_order_is_dropped_and_said(
    signals: dict[str, Floats], tmp_path: Path
) -> None:
    bad = {name: values.copy() for name, values in signals.items()}
    bad["roll"][50] = np.nan
    bad["pitch"][60] = np.inf
    bad["time"][100] = bad["time"][99]
    for name in bad:
        bad[name][[200, 201]] = bad[name][[201, 200]]
    log = read_log(write_csv(tmp_path / "log.csv", bad))
    assert said(log, "roll, pitch: 1 of 600 samples are not finite numbers")
    assert said(log, "samples have the time of another")
    assert said(log, "all signals: time goes back 1 times")
    assert np.isfinite(log.signals["roll"]).all()
    assert log.signals["roll"][201] == pytest.approx(signals["roll"][201], abs=1e-6)


def test_time_that_runs_backwards_is_refused(signals: dict[str, Floats], tmp_path: Path) -> None:
    bad = signals | {"time": signals["time"][::-1]}
    with pytest.raises(UsageError, match="time goes back 599 times"):
        read_log(write_csv(tmp_path / "log.csv", bad))


def test_a_gap_is_not_filled(signals: dict[str, Floats], tmp_path: Path) -> None:
    holed = {name: np.delete(values, np.arange(300, 360)) for name, values in signals.items()}
    log = read_log(write_csv(tmp_path / "log.csv", holed))
    missing = np.isnan(log.signals["roll"])
    assert said(log, "roll, pitch, yaw, ")
    assert said(log, ": 1 gap longer than 0.25 s, the longest 1.22 s")
    assert missing.sum() == 60
    assert missing[300:360].all()


def test_a_ulog_cut_in_the_middle_is_read_up_to_there(signals: dict[str, Floats], tmp_path: Path) -> None:
    path = write_ulog(tmp_path / "log.ulg", signals)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3 - 5])
    log = read_log(path)
    assert said(log, "the file ends inside a message")
    assert 6.0 < log.time[-1] < 9.0
    assert np.allclose(log.signals["roll"], signals["roll"][: len(log.time)], atol=2e-3)


@pytest.mark.parametrize("name", ["log.ulg", "log.bin"])
def test_a_missing_signal_is_named_and_the_others_listed(name: str, signals: dict[str, Floats], tmp_path: Path) -> None:
    without = "vehicle_angular_velocity" if name == "log.ulg" else "RATE"
    log = read_log(WRITERS[name](tmp_path / name, signals, (without,)))
    with pytest.raises(UsageError, match="needs roll_rate, which this log") as error:
        log.require(("roll", "roll_rate"), "rotation")
    assert "there: " in str(error.value)
    assert "velocity_north" in str(error.value)


def test_binary_rubbish_is_refused(tmp_path: Path) -> None:
    for name, beginning in (("log.ulg", b"ULog\x01\x12\x35\x01"), ("log.bin", b"\xa3\x95\x80")):
        path = tmp_path / name
        path.write_bytes(beginning + bytes(range(256)) * 3)
        with pytest.raises(UsageError, match=name):
            read_log(path)


@pytest.mark.long
def test_a_damaged_dataflash_log_says_so_in_few_lines(tmp_path: Path, capfd: Any) -> None:
    """The library writes a line for each byte that it cannot place, some of them past Python."""
    path = write_dataflash(tmp_path / "log.bin", flown(6.0))
    data = bytearray(path.read_bytes())
    data[20_000:24_000] = bytes(4000)
    path.write_bytes(bytes(data))
    notes = read_log(path).notes
    assert len(notes) < 15
    assert capfd.readouterr() == ("", "")


def test_of_two_boots_in_a_dataflash_log_one_is_read(signals: dict[str, Floats], tmp_path: Path) -> None:
    short, whole = write_dataflash(tmp_path / "a.bin", flown(6.0, seed=2)), write_dataflash(tmp_path / "b.bin", signals)
    both = tmp_path / "log.bin"
    for first, second, number in ((short, whole, 2), (whole, short, 1)):
        both.write_bytes(first.read_bytes() + second.read_bytes())
        for boot, why in ((None, "the one with the most messages (--boot N reads another)"), (number, "as asked")):
            log = read_log(both, boot=boot)
            assert said(log, f"boot {number} of 2 is read, 7.00 to 18.98 s, {why}")
            assert not said(log, "time goes back")
            for name in ("roll", "velocity_down", "throttle"):
                assert np.isclose(log.signals[name], signals[name][: len(log.time)], atol=2e-3).mean() > 0.97, name
    assert said(read_log(both, boot=2), "boot 2 of 2 is read, 7.00 to 12.98 s, as asked")
    with pytest.raises(LogError, match=r"log.bin: has no boot 3; known: 1 \(7.00 to 18.98 s\), 2 \(7.00 to 12.98 s\)"):
        read_log(both, boot=3)
    with pytest.raises(UsageError, match=r"--boot 1: .*plain.csv is no DataFlash log; other logs have one boot each"):
        read_log(write_csv(tmp_path / "plain.csv", signals), boot=1)


@pytest.mark.parametrize("instances", [(1,), (2, 3)])
def test_any_core_and_any_battery_of_a_dataflash_log_is_read(
    instances: tuple[int, ...], signals: dict[str, Floats], tmp_path: Path
) -> None:
    log = read_log(write_dataflash(tmp_path / "log.bin", signals, instances=instances))
    for kind in ("XKF1", "BAT"):
        assert said(log, f"{kind}: instance {instances[0]} is read")
    for name in ("battery", "velocity_north"):
        assert np.isclose(log.signals[name], signals[name][: len(log.time)], atol=2e-3).mean() > 0.97, name


def test_a_wrong_time_in_a_dataflash_log_is_no_boot(signals: dict[str, Floats], tmp_path: Path) -> None:
    path = write_dataflash(tmp_path / "log.bin", signals)
    data = bytearray(path.read_bytes())
    (at, *_) = [i for i in range(20_000, len(data) - 11) if data[i : i + 3] == b"\xa3\x95\x01"]
    data[at + 3 : at + 11] = struct.pack("<Q", 500_000)
    path.write_bytes(bytes(data))
    log = read_log(path)
    assert not said(log, "boots")
    assert said(log, "time goes back 1 times")


def ulog_message(kind: bytes, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), kind[0]) + payload


def whole_messages(content: bytes) -> tuple[bytes, list[str]]:
    messages, notes = ulog_messages.whole_messages(content)
    return b"".join(messages), notes


class TestMessagesOfAULog:
    """Walked by their lengths: a library that meets a damaged one may never come back."""

    HEADER = b"ULog\x01\x12\x35\x01" + bytes(8)
    SYNC = ulog_message(b"S", bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12)))

    def test_a_message_of_no_type_beyond_the_end_ends_the_log(self, tmp_path: Path) -> None:
        content = self.HEADER + b"\xff\xff\x00" + bytes(20)
        assert whole_messages(content) == (
            self.HEADER,
            ["the file ends inside a message: the last 23 bytes are lost (log cut off)"],
        )
        path = tmp_path / "log.ulg"
        path.write_bytes(content)
        for read in (read_log, read_inertial):
            with pytest.raises(LogError, match=re.escape(str(path))):
                read(path)

    def test_after_damage_it_goes_on_at_the_next_synchronisation(self) -> None:
        good, bad = ulog_message(b"I", b"abc"), b"\x05\x00\x00" + bytes(40)
        kept, notes = whole_messages(self.HEADER + good + bad + self.SYNC + good)
        assert kept == self.HEADER + good + self.SYNC + good
        assert notes == ["the file is damaged; only the parts that can be read are used"]

    def test_a_whole_log_is_left_as_it_is(self) -> None:
        content = self.HEADER + ulog_message(b"B", bytes(40)) + ulog_message(b"F", b"t:uint64_t timestamp;")
        content += ulog_message(b"A", b"\x00\x01\x00t") + ulog_message(b"D", b"\x01\x00timestam")
        assert whole_messages(content) == (content, [])

    def test_a_synchronisation_with_a_damaged_header_is_passed(self) -> None:
        good = ulog_message(b"I", b"abc")
        kept, notes = whole_messages(self.HEADER + good + b"\x08\x00s" + self.SYNC[3:] + good)
        assert kept == self.HEADER + good + self.SYNC + good
        assert notes == ["the file is damaged; only the parts that can be read are used"]

    def test_messages_in_the_wrong_section_are_left_out(self) -> None:
        """pyulog reads these byte by byte, and the first part sends it back to the second for ever."""
        info = bytearray(ulog_message(b"I", b"\x09char[3] x" + bytes(9000)))
        info[-7445:-7442] = struct.pack("<HB", 7442, ord("Z"))
        early = bytes(info) + ulog_message(b"D", bytes(10001))
        assert whole_messages(self.HEADER + early) == (self.HEADER + bytes(info), [])
        begun = ulog_message(b"A", b"\x00\x01\x00t")
        late = ulog_message(b"F", b"") + ulog_message(b"B", bytes(40)) + ulog_message(b"R", b"")
        assert whole_messages(self.HEADER + begun + late) == (self.HEADER + begun, [])

    def test_appended_data_follows_the_cut(self) -> None:
        good, cut = ulog_message(b"L", b"6" + bytes(8) + b"text"), b"\xff\x00Dtext"
        place = 16 + 43 + len(good) + len(cut)
        flags = ulog_message(b"B", bytes(8) + b"\x01" + bytes(7) + struct.pack("<3Q", place, 0, 2**63))
        kept, notes = whole_messages(self.HEADER + flags + good + cut + good)
        assert kept == self.HEADER + flags[:19] + bytes(24) + good + good
        assert notes == []

    @pytest.mark.parametrize(
        ("messages", "told"),
        [
            ([b"Ft:u[65535] x;", b"Fu:v[65535] x;", b"Fv:float x;", b"A\0\0\0t"], "more than 200000 fields in all"),
            ([b"Ft:" + b"float[60000] x;" * 4, b"A\0\0\0t"], "more than 200000 fields in all"),
            ([b"Ft:float[60000] x;", *[b"A\0\0\0t"] * 4], "more than 200000 fields in all"),
            ([b"Ft:t x;t y;", b"A\0\0\0t"], "nested more than 20 deep"),
            (
                [
                    b"Fsensor_combined:float[3] gyro_rad;float[3] accelerometer_m_s2;",
                    b"A\0\0\0sensor_combined",
                    b"D\0\0" + bytes(24),
                ],
                "no topic sensor_combined with timestamp|no data of the topics",
            ),
        ],
    )
    def test_formats_that_no_memory_holds_are_refused(self, messages: list[bytes], told: str, tmp_path: Path) -> None:
        path = tmp_path / "log.ulg"
        path.write_bytes(self.HEADER + b"".join(ulog_message(each[:1], each[1:]) for each in messages))
        for read in (read_log, read_inertial):
            with pytest.raises(LogError, match=told):
                read(path)

    @pytest.mark.parametrize("seed", range(100))
    def test_what_is_left_of_a_mutated_log_is_whole(self, seed: int) -> None:
        """By construction pyulog gets messages that follow each other to the last byte, whatever came in."""
        content, _ = whole_messages(mutated(np.random.default_rng(seed), ulog(), binary=True))
        place = 16
        while place < len(content):
            place += 3 + int.from_bytes(content[place : place + 2], "little")
        assert place == len(content) or len(content) < 16
