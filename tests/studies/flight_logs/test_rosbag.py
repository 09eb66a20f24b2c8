"""Bags of ROS 2 as flight logs, written by rosbags from a simulated flight, turned by SciPy."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
from log_writing import Floats, flown

from qrsim.errors import RunError, UsageError
from qrsim.studies.flight_logs.reading import read_log

pytest.importorskip("rosbags", reason="python -m pip install 'qrsim[ros2]'")

TARGET = "mavros_msgs/msg/AttitudeTarget"
# As mavros has it, constants included.
FIELDS = """std_msgs/Header header
uint8 type_mask
uint8 IGNORE_ROLL_RATE = 1
uint8 IGNORE_PITCH_RATE = 2
uint8 IGNORE_YAW_RATE = 4
uint8 IGNORE_THRUST = 64
uint8 IGNORE_ATTITUDE = 128
geometry_msgs/Quaternion orientation
geometry_msgs/Vector3 body_rate
float32 thrust
"""
NED_OF_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_OF_FLU = np.diag([1.0, -1.0, -1.0])
# A run of qrsim stamps from zero, another robot from 1970.
EPOCH_S = 1_700_000_000.0


@cache
def store() -> Any:
    """The messages of ROS 2 and of mavros, which take a while to import."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    found = get_typestore(Stores.ROS2_JAZZY)
    found.register(get_types_from_msg(FIELDS, TARGET))
    return found


@pytest.fixture(scope="module")
def signals() -> dict[str, Floats]:
    return flown(6.0)


def make(name: str, *values: Any, **fields: Any) -> Any:
    return store().types[name](*values, **fields)


def header(time: float) -> Any:
    stamp = make("builtin_interfaces/msg/Time", int(time), round((time % 1.0) * 1e9))
    return make("std_msgs/msg/Header", stamp, "map")


def vector(values: Any) -> Any:
    return make("geometry_msgs/msg/Vector3", *map(float, values))


def quaternion(matrix: Any) -> Any:
    x, y, z, w = scipy.spatial.transform.Rotation.from_matrix(NED_OF_ENU.T @ matrix @ FRD_OF_FLU).as_quat()
    return make("geometry_msgs/msg/Quaternion", x, y, z, w)


def attitudes(signals: dict[str, Floats], suffix: str = "") -> Any:
    yaw = signals["yaw"]
    angles = np.stack([yaw, signals[f"pitch{suffix}"], signals[f"roll{suffix}"]], axis=1)
    return scipy.spatial.transform.Rotation.from_euler("ZYX", angles).as_matrix()


def odometry(signals: dict[str, Floats], i: int, time: float, matrix: Any) -> Any:
    north_east_down = np.array([signals[f"velocity_{axis}"][i] for axis in ("north", "east", "down")])
    rates = np.array([signals[f"{axis}_rate"][i] for axis in ("roll", "pitch", "yaw")])
    pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", 0.0, 0.0, 0.0), quaternion(matrix))
    twist = make("geometry_msgs/msg/Twist", vector(FRD_OF_FLU @ matrix.T @ north_east_down), vector(FRD_OF_FLU @ rates))
    return make(
        "nav_msgs/msg/Odometry",
        header(time),
        "base_link",
        make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
        make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
    )


def target(signals: dict[str, Floats], i: int, time: float, matrix: Any, mask: int = 0) -> Any:
    rates = FRD_OF_FLU @ np.array([0.0, 0.0, signals["yaw_rate_command"][i]])
    return make(
        TARGET,
        header(time),
        type_mask=mask,
        orientation=quaternion(matrix),
        body_rate=vector(rates),
        thrust=float(signals["throttle"][i]),
    )


def write_bag(
    folder: Path,
    signals: dict[str, Floats],
    namespaces: tuple[str, ...] = ("uav1/mavros",),
    storage: str = "MCAP",
    commanded: bool = True,
) -> Path:
    """Write odometry and targets of vehicles that fly the same, as mavros calls them."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    measured, asked = attitudes(signals), attitudes(signals, "_command")
    with Writer(folder, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        for name in namespaces:
            odom = writer.add_connection(f"/{name}/local_position/odom", "nav_msgs/msg/Odometry", typestore=store())
            topic = f"/{name}/setpoint_raw/target_attitude"
            aim = writer.add_connection(topic, TARGET, typestore=store()) if commanded else None
            for i, time in enumerate((EPOCH_S + signals["time"]).tolist()):
                nanoseconds = round(time * 1e9)
                cdr = store().serialize_cdr(odometry(signals, i, time, measured[i]), "nav_msgs/msg/Odometry")
                writer.write(odom, nanoseconds, cdr)
                if aim is not None:
                    cdr = store().serialize_cdr(target(signals, i, time, asked[i]), TARGET)
                    writer.write(aim, nanoseconds, cdr)
    return folder


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_a_bag_of_mavros_is_read(storage: str, signals: dict[str, Floats], tmp_path: Path) -> None:
    log = read_log(write_bag(tmp_path / "bag", signals, storage=storage))
    assert (log.kind, log.dt, len(log.time)) == ("bag of ROS 2", 0.02, 300)
    assert set(log.signals) == set(signals) - {"time", "battery"}
    for name, values in log.signals.items():
        np.testing.assert_allclose(values[1:-1], signals[name][1:-1], atol=2e-4, err_msg=name)


def test_a_file_of_a_bag_is_read(signals: dict[str, Floats], tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", signals)
    (file,) = folder.glob("*.mcap")
    found, whole = read_log(file).signals["roll"], read_log(folder).signals["roll"]
    np.testing.assert_array_equal(found, whole)


def test_of_several_vehicles_one_is_chosen(signals: dict[str, Floats], tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", signals, ("uav1", "uav2"))
    with pytest.raises(UsageError, match="a bag of several vehicles, uav1, uav2; --namespace NAME chooses one"):
        read_log(folder)
    with pytest.raises(UsageError, match=r"no vehicle 'uav3'; did you mean 'uav[12]'"):
        read_log(folder, "uav3")
    assert any(note.startswith("vehicle uav2: topics local_position/odom") for note in read_log(folder, "/uav2").notes)


def test_a_bag_without_what_is_needed_says_what_and_what_it_has(signals: dict[str, Floats], tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", signals, commanded=False)
    with pytest.raises(UsageError) as caught:
        read_log(folder)
    assert "no topic of a vehicle's attitude asked for, one of setpoint_raw/target_attitude, " in str(caught.value)
    assert "there: /uav1/mavros/local_position/odom (nav_msgs/msg/Odometry)" in str(caught.value)


def test_what_is_no_bag_is_refused_in_one_line(signals: dict[str, Floats], tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match=r"a folder without metadata.yaml is no bag of ROS 2"):
        read_log(tmp_path / "empty")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}", encoding="utf-8")
    with pytest.raises(UsageError, match=r"a run of qrsim; qrsim export .*run --format rosbag2 makes a bag of it"):
        read_log(tmp_path / "run")
    (tmp_path / "log.csv").write_text("time [s],roll [rad]\n", encoding="utf-8")
    with pytest.raises(UsageError, match=r"--namespace uav1: .*log.csv is no bag of ROS 2"):
        read_log(tmp_path / "log.csv", "uav1")
    with pytest.raises(UsageError, match=r"nothing.mcap: no such file"):
        read_log(tmp_path / "nothing.mcap", "uav1")


@pytest.mark.parametrize("kept", [0, 100, 5000])
def test_a_bag_that_was_cut_off_is_refused_in_one_line(kept: int, signals: dict[str, Floats], tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", signals)
    (file,) = folder.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises((RunError, UsageError)) as caught:
        read_log(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.long
def test_a_flown_vehicle_is_found_in_the_bag_of_its_run(tmp_path: Path) -> None:
    """With a roll and pitch spring 30 % above that of the published Pelican, 179.8.

    See docs/explanation/models/vehicle.md.
    """
    import yaml

    from qrsim import cli

    route = [[15, 5, -25], [-10, 15, -15], [5, -15, -30], [0, 10, -20]]
    scenario = {
        "name": "zigzag",
        "duration": 30,
        "fleets": {
            "uav": {
                "vehicle": {"type": "pelican", "kpq1": 1.3 * 179.8},
                "controller": {"type": "waypoint", "feed": "truth"},
                "sensors": {"gyroscope": {"type": "gyroscope"}},
                "vehicles": [{"position_ned": [0, 0, -20], "waypoints_ned": route}],
            }
        },
    }
    (tmp_path / "zigzag.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
    run, vehicle = str(tmp_path / "run"), tmp_path / "found.yaml"
    assert cli.main(["run", str(tmp_path / "zigzag.yaml"), "--out", run, "--no-figure"]) == 0
    assert cli.main(["export", run, "--format", "rosbag2"]) == 0
    bag = f"{run}/export/run.rosbag2"
    assert cli.main(["identify", bag, "--fit", "kpq0,kpq1,kpq2", "--quiet", "-o", str(vehicle)]) == 0
    found = yaml.safe_load(vehicle.read_text(encoding="utf-8"))["vehicle"]
    assert found["kpq1"] == pytest.approx(1.3 * 179.8, rel=0.03)
