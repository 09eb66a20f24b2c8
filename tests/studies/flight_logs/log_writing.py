"""Small logs of a simulated vehicle in every format that is read."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.simulation.openloop import simulate_open_loop

DT = 0.02
Floats = np.ndarray[Any, Any]
NAMES = (
    "roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", "velocity_north", "velocity_east", "velocity_down",
)  # fmt: skip


def steps(rows: int, size: float, rng: np.random.Generator, hold: int = 30) -> Floats:
    """A random signal (rows,) that stays for ``hold`` rows."""
    return np.repeat(rng.uniform(-size, size, rows // hold + 1), hold)[:rows]


def flown(seconds: float = 12.0, seed: int = 1, vehicle: Quadrotor | None = None, still: str = "") -> dict[str, Floats]:
    """Signals of an open-loop flight, in SI, with their time; the axis ``still`` is not commanded."""
    rng = np.random.default_rng(seed)
    rows = round(seconds / DT)
    size = {axis: 0.0 if axis == still else full for axis, full in (("roll", 0.25), ("pitch", 0.25), ("yaw", 0.8))}
    commands = np.stack(
        [
            steps(rows, size["pitch"], rng),
            steps(rows, size["roll"], rng, 25),
            0.59 + steps(rows, 0.1, rng, 35),
            steps(rows, size["yaw"], rng, 50),
            np.full(rows, 12.0),
        ],
        axis=1,
    )
    vehicle = vehicle or Quadrotor()
    start = np.zeros(13)
    start[12] = float(vehicle.mass) * 9.81
    after = simulate_open_loop(vehicle, commands, start)[:-1, :13]
    states = np.concatenate([start[None], after])
    roll, pitch, yaw = states[:, 3:6].T
    u, v, w = states[:, 6:9].T
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    north = cp * cy * u + (sr * sp * cy - cr * sy) * v + (cr * sp * cy + sr * sy) * w
    east = cp * sy * u + (sr * sp * sy + cr * cy) * v + (cr * sp * sy - sr * cy) * w
    down = -sp * u + sr * cp * v + cr * cp * w
    measured = np.column_stack([roll, pitch, yaw, *states[:, 9:12].T, north, east, down])
    measured += 1e-3 * rng.standard_normal(measured.shape)
    asked = dict(
        zip(("pitch_command", "roll_command", "throttle", "yaw_rate_command", "battery"), commands.T, strict=True)
    )
    return {"time": DT * np.arange(rows), **dict(zip(NAMES, measured.T, strict=True)), **asked}


def write_csv(path: Path, signals: dict[str, Floats], units: dict[str, tuple[str, float]] | None = None) -> Path:
    """Write columns 'name [unit]'; ``units`` says in what unit, and the factor from SI, where it is not SI."""
    from qrsim.studies.flight_logs import SIGNALS

    named = {"time": ("s", 1.0)} | {name: (signal.unit, 1.0) for name, signal in SIGNALS.items()} | (units or {})
    header = ",".join(f"{name} [{named[name][0]}]" for name in signals)
    columns = np.column_stack([signals[name] * named[name][1] for name in signals])
    np.savetxt(path, columns, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


_ULOG_TOPICS = {
    "vehicle_attitude": "float[4] q",
    "vehicle_attitude_setpoint": "float[4] q_d;float yaw_sp_move_rate;float[3] thrust_body",
    "vehicle_angular_velocity": "float[3] xyz",
    "vehicle_local_position": "float vx;float vy;float vz",
    "battery_status": "float voltage_v",
}
_OLD_TOPICS = {
    "vehicle_attitude": "float rollspeed;float pitchspeed;float yawspeed;float[4] q",
    "vehicle_attitude_setpoint": "float[4] q_d;float yaw_sp_move_rate;float thrust",
}


def _quaternion(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    cr, sr, cp, sp, cy, sy = (f(0.5 * a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.column_stack([w, x, y, z])


def write_ulog(path: Path, signals: dict[str, Floats], without: tuple[str, ...] = (), old: bool = False) -> Path:
    """Write a PX4 log; velocity comes at 25 Hz and the battery at 5 Hz, as there.

    An old one has the body rates with the attitude, and the thrust as a number.
    """
    s = signals
    zero = np.zeros(len(s["time"]))
    tables: dict[str, tuple[int, Floats]] = {
        "vehicle_attitude": (1, _quaternion(s["roll"], s["pitch"], s["yaw"])),
        "vehicle_attitude_setpoint": (
            1,
            np.column_stack(
                [
                    _quaternion(s["roll_command"], s["pitch_command"], zero),
                    s["yaw_rate_command"],
                    zero,
                    zero,
                    -s["throttle"],
                ]
            ),
        ),
        "vehicle_angular_velocity": (1, np.column_stack([s["roll_rate"], s["pitch_rate"], s["yaw_rate"]])),
        "vehicle_local_position": (2, np.column_stack([s["velocity_north"], s["velocity_east"], s["velocity_down"]])),
        "battery_status": (10, s["battery"][:, None]),
    }
    topics = _ULOG_TOPICS
    if old:
        rates = np.column_stack([s["roll_rate"], s["pitch_rate"], s["yaw_rate"]])
        asked = tables["vehicle_attitude_setpoint"][1]
        tables |= {
            "vehicle_attitude": (1, np.column_stack([rates, tables["vehicle_attitude"][1]])),
            "vehicle_attitude_setpoint": (1, np.column_stack([asked[:, :5], s["throttle"]])),
        }
        without = (*without, "vehicle_angular_velocity")
        topics = topics | _OLD_TOPICS
    content = b"ULog\x01\x12\x35" + struct.pack("<BQ", 1, 0)

    def message(kind: bytes, payload: bytes) -> bytes:
        return struct.pack("<H", len(payload)) + kind + payload

    for name, fields in topics.items():
        content += message(b"F", f"{name}:uint64_t timestamp;{fields};".encode())
    rows: list[tuple[int, int, Floats]] = []
    for number, name in enumerate(tables):
        if name not in without:
            content += message(b"A", struct.pack("<BH", 0, number) + name.encode())
            every, table = tables[name]
            rows += [(int(1e6 * (5.0 + s["time"][i])), number, table[i]) for i in range(0, len(table), every)]
    for stamp, number, row in sorted(rows, key=lambda entry: entry[:2]):
        content += message(b"D", struct.pack(f"<HQ{len(row)}f", number, stamp, *row))
    path.write_bytes(content)
    return path


_BIN_MESSAGES = {
    "ATT": (1, "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    "RATE": (2, "Qffffff", "TimeUS,RDes,R,PDes,P,YDes,Y"),
    "CTUN": (3, "Qf", "TimeUS,ThO"),
    "BAT": (4, "QBf", "TimeUS,Inst,Volt"),
    "XKF1": (5, "QBfff", "TimeUS,C,VN,VE,VD"),
}


def write_dataflash(
    path: Path, signals: dict[str, Floats], without: tuple[str, ...] = (), instances: tuple[int, ...] = (0, 1)
) -> Path:
    """Write an ArduPilot log; a second battery and a second estimator say something else.

    The first of ``instances`` is right, whichever number it has.
    """
    s = signals
    formats = {"Q": "Q", "f": "f", "B": "B"}

    def packet(number: int, payload: bytes) -> bytes:
        return b"\xa3\x95" + bytes([number]) + payload

    def text(words: str, length: int) -> bytes:
        return words.encode().ljust(length, b"\0")

    content = packet(
        128,
        struct.pack("<BB", 128, 89) + text("FMT", 4) + text("BBnNZ", 16) + text("Type,Length,Name,Format,Columns", 64),
    )
    for name, (number, layout, columns) in _BIN_MESSAGES.items():
        length = 3 + struct.calcsize("<" + "".join(formats[c] for c in layout))
        content += packet(
            128, struct.pack("<BB", number, length) + text(name, 4) + text(layout, 16) + text(columns, 64)
        )
    degrees = {name: np.degrees(s[name]) for name in s if s[name].ndim == 1}
    yaw = degrees["yaw"] % 360.0
    for i, seconds in enumerate(s["time"]):
        stamp = int(1e6 * (7.0 + seconds))
        d = {name: float(degrees[name][i]) for name in degrees}
        rows = {
            "ATT": [(stamp, d["roll_command"], d["roll"], d["pitch_command"], d["pitch"], 0.0, float(yaw[i]))],
            "RATE": [(stamp, 0.0, d["roll_rate"], 0.0, d["pitch_rate"], d["yaw_rate_command"], d["yaw_rate"])],
            "CTUN": [(stamp, float(s["throttle"][i]))],
            "BAT": [(stamp, number, 3.0 if j else float(s["battery"][i])) for j, number in enumerate(instances)]
            if i % 5 == 0
            else [],
            "XKF1": [
                (stamp, core, *(float(s[f"velocity_{axis}"][i]) + j for axis in ("north", "east", "down")))
                for j, core in enumerate(instances)
            ],
        }
        for name, messages in rows.items():
            number, layout, _ = _BIN_MESSAGES[name]
            if name not in without:
                for values in messages:
                    content += packet(number, struct.pack("<" + layout, *values))
    path.write_bytes(content)
    return path
