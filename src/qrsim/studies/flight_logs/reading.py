"""Choice of the reader of a file."""

from __future__ import annotations

from pathlib import Path

from qrsim.errors import LogError, UsageError, did_you_mean_file
from qrsim.files.recordings import RECORDINGS, data_folder
from qrsim.files.user_files import open_file
from qrsim.studies.flight_logs.rosbag import is_bag, read_bag
from qrsim.studies.flight_logs.signals import FlightLog

_ULOG_MAGIC = b"ULog"
_DATAFLASH_HEADER = b"\xa3\x95"
FORMATS = "PX4 ULog (.ulg), ArduPilot DataFlash (.bin), a bag of ROS 2, CSV with names and units, the public recordings"


def read_log(path: Path, namespace: str | None = None, boot: int | None = None) -> FlightLog:
    """Read a flight log of any supported format, recognised by its content; ``boot`` selects one of several.

    Args:
        path: of a file, or of the folder of a bag.
        namespace: of the vehicle in a bag; see ``rosbag.read_bag``.
        boot: number of the boot in a DataFlash log, from 1; see ``dataflash.read_dataflash``.

    Raises:
        UsageError: no such file, a namespace without a bag, or a boot without a DataFlash log.
        LogError: empty, no format that is known, or what the reader of the format finds wrong.
        RunError: a bag is damaged.
    """
    if str(path) in RECORDINGS and not path.exists():
        path = data_folder() / path
    if path.exists() and is_bag(path):
        if boot is not None:
            raise _no_boots(path, boot)
        return read_bag(path, namespace)
    if namespace is not None and path.exists():
        raise UsageError(f"--namespace {namespace}: {path} is no bag of ROS 2, which alone has namespaces")
    try:
        with open_file(path) as stream:
            beginning = stream.read(4096)
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file{did_you_mean_file(path)}") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    if not beginning.strip():
        raise LogError(f"{path}: the file is empty; expected {FORMATS}")
    if beginning.startswith(_DATAFLASH_HEADER):
        from qrsim.studies.flight_logs.dataflash import read_dataflash

        return read_dataflash(path, boot)
    if boot is not None:
        raise _no_boots(path, boot)
    if beginning.startswith(_ULOG_MAGIC):
        from qrsim.studies.flight_logs.ulog import read_ulog

        return read_ulog(path)
    if b"\0" in beginning:
        raise LogError(f"{path}: neither ULog nor DataFlash nor text; expected {FORMATS}")
    first = beginning.decode("utf-8-sig", errors="replace").partition("\n")[0]
    if any(c.isalpha() for c in first.replace("e", "").replace("E", "").replace("nan", "")):
        from qrsim.studies.flight_logs.table import read_table

        return read_table(path)
    from qrsim.studies.flight_logs.recorded import read_recording

    return read_recording(path)


def _no_boots(path: Path, boot: int) -> UsageError:
    """Return the error for choosing a boot of a log that does not have several."""
    return UsageError(f"--boot {boot}: {path} is no DataFlash log; other logs have one boot each")
