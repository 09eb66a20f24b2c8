"""Small logs and ephemerides to be mutated, written here byte by byte."""

from __future__ import annotations

import struct
from functools import cache

import numpy as np

ROWS, DT = 400, 0.02
ULOG_TOPICS = (
    ("vehicle_attitude", "float[4] q", 4),
    ("vehicle_angular_velocity", "float[3] xyz", 3),
    ("vehicle_local_position", "float vx;float vy;float vz", 3),
    ("vehicle_attitude_setpoint", "float[4] q_d;float yaw_sp_move_rate;float[3] thrust_body", 8),
    ("battery_status", "float voltage_v", 1),
)


@cache
def csv_log() -> bytes:
    """Return a table with names and units."""
    names = ("roll [rad]", "pitch [deg]", "roll_command [rad]", "pitch_command [rad]", "throttle [1]", "battery [V]")
    rows = [f"{DT * i:.3f},{0.1 * np.sin(i / 20):.5f},{np.cos(i / 25):.4f},0.1,-0.05,0.59,11.9" for i in range(ROWS)]
    return "\n".join([",".join(["time [s]", *names]), *rows, ""]).encode()


@cache
def rig_log() -> bytes:
    """Return a table in the layout of the thrust rig."""
    rows = [f"{i},{2000 + i},{16 + 0.01 * i:.3f},11.5" for i in range(ROWS)]
    return "\n".join([*rows, ""]).encode()


@cache
def ulog() -> bytes:
    """Return a PX4 log of eight seconds."""

    def message(kind: bytes, payload: bytes) -> bytes:
        return struct.pack("<H", len(payload)) + kind + payload

    content = b"ULog\x01\x12\x35" + struct.pack("<BQ", 1, 0)
    for name, fields, _ in ULOG_TOPICS:
        content += message(b"F", f"{name}:uint64_t timestamp;{fields};".encode())
    for number, (name, _, _) in enumerate(ULOG_TOPICS):
        content += message(b"A", struct.pack("<BH", 0, number) + name.encode())
    for i in range(ROWS):
        for number, (name, _, count) in enumerate(ULOG_TOPICS):
            values = (
                [1.0] + [0.01 * np.sin(i / 20)] * (count - 1) if "attitude" in name else [0.1 * np.cos(i / 30)] * count
            )
            values = [12.0] if name == "battery_status" else values
            content += message(b"D", struct.pack(f"<HQ{count}f", number, int(1e6 * (5 + DT * i)), *values))
    return content


@cache
def inertial_ulog() -> bytes:
    """Return a PX4 log at rest of gyroscope and accelerometer, with messages of most types."""

    def message(kind: bytes, payload: bytes) -> bytes:
        return struct.pack("<H", len(payload)) + kind + payload

    content = b"ULog\x01\x12\x35" + struct.pack("<BQ", 1, 0) + message(b"B", bytes(40))
    content += message(b"F", b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;")
    content += message(b"I", b"\x09char[3] x" + b"abc") + message(b"P", b"\x07float a" + bytes(4))
    content += message(b"M", b"\x00\x09char[3] y" + b"abc") + message(b"Q", b"\x01\x07float a" + bytes(4))
    content += message(b"A", struct.pack("<BH", 0, 0) + b"sensor_combined")
    for i in range(ROWS):
        content += message(b"D", struct.pack("<HQ6f", 0, int(1e6 * DT * i), *np.sin(i + np.arange(6.0))))
        if i % 50 == 0:
            content += message(b"S", bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12)))
            content += message(b"L", b"6" + struct.pack("<Q", i) + b"text") + message(b"O", b"\x01\x00")
    return content


@cache
def dataflash() -> bytes:
    """Return an ArduPilot log of eight seconds."""

    def packet(number: int, payload: bytes) -> bytes:
        return b"\xa3\x95" + bytes([number]) + payload

    def described(number: int, name: str, layout: str, columns: str) -> bytes:
        length = 3 + (89 - 3 if number == 128 else struct.calcsize("<" + layout))
        texts = (text.encode().ljust(size, b"\0") for text, size in ((name, 4), (layout, 16), (columns, 64)))
        return packet(128, struct.pack("<BB", number, length) + b"".join(texts))

    content = described(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    content += described(1, "ATT", "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
    content += described(3, "CTUN", "Qf", "TimeUS,ThO") + described(4, "BAT", "QBf", "TimeUS,Inst,Volt")
    for i in range(ROWS):
        stamp, angle = int(1e6 * (7.0 + DT * i)), 5.0 * np.sin(i / 20)
        content += packet(1, struct.pack("<Qffffff", stamp, angle, angle, -angle, angle, 0.0, 90.0))
        content += packet(3, struct.pack("<Qf", stamp, 0.59)) + packet(4, struct.pack("<QBf", stamp, 0, 12.0))
    return content


@cache
def sp3() -> bytes:
    """Return an SP3-c file of 24 satellites on circular orbits, 20 epochs of 900 s."""
    names = [f"G{number:02}" for number in range(1, 25)]
    ids = ["".join(names[:17]), "".join(names[17:] + ["  0"] * 10), *["  0" * 17] * 3]
    lines = ["#cP2010  8 31 15  0  0.00000000      20 ORBIT IGS05 HLM  IGS"]
    lines.append("## 1599 226800.00000000   900.00000000 55439 0.6250000000000")
    lines += [f"+  {24 if row == 0 else '':>3}   {part}" for row, part in enumerate(ids)]
    lines += ["++         0" + "  0" * 16] * 5
    lines += [
        "%c G  cc GPS ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
        "%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
    ]
    lines += ["%f  1.2500000  1.025000000  0.00000000000  0.000000000000000"] * 2
    lines += ["%i    0    0    0    0      0      0      0      0         0"] * 2 + ["/* a comment"] * 4
    for epoch in range(20):
        minutes = 15 * epoch
        lines.append(f"*  2010  8 31 {15 + minutes // 60:2} {minutes % 60:2}  0.00000000" if minutes < 540 else "")
        for k, name in enumerate(names):
            angle, node = 2 * np.pi * (k % 4 / 4 + 900.0 * epoch / 43082.0), 2 * np.pi * (k // 4) / 6
            x, y, z = 26560.0 * np.array([np.cos(angle), np.sin(angle) * np.cos(0.96), np.sin(angle) * np.sin(0.96)])
            east = np.cos(node) * x - np.sin(node) * y, np.sin(node) * x + np.cos(node) * y
            lines.append(f"P{name}{east[0]:14.6f}{east[1]:14.6f}{z:14.6f}{100.0 + k:14.6f}")
    return "\n".join([*(line for line in lines if line), "EOF", ""]).encode()
