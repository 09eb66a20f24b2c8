"""The public recordings that validation and tests read: location, integrity, download.

They were released with the reference implementation of Symington, De Nardi, Julier, Hailes, "Simulating Quadrotor
UAVs in Outdoor Scenarios", IROS 2014 (University College London, Modified BSD licence); the orbit file is a product
of the US National Geodetic Survey (public domain). They are not part of this project: ``qrsim data fetch`` gets them.
"""

from __future__ import annotations

import hashlib
import os
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from qrsim import extras
from qrsim.errors import RunError, UsageError, did_you_mean, os_error_as
from qrsim.files.user_files import read_bytes

UPSTREAM = "https://raw.githubusercontent.com/UCL-CompLACS/qrsim/efd8539a11604edfe8fa7c95a9e1ea1753ad516e/"
FOLDER_VARIABLE = "QRSIM_DATA_DIR"
TIMEOUT_S = 30.0


@dataclass(frozen=True)
class Recording:
    """One file: its path in the upstream repository and the sha256 of its bytes."""

    source: str
    sha256: str

    @property
    def url(self) -> str:
        """Address from which the recording is downloaded."""
        return UPSTREAM + self.source


RECORDINGS: dict[str, Recording] = {
    "rotation_rig.csv": Recording(
        "tests/dynamics/preliminaryRotation_allBalanced01_2011-09-02-20-47-53_synced-50Hz.csv",
        "6a0e89f74ca88e76fcff73b705f667cede13214e11846bd930a81926422861e7",
    ),
    "thrust_rig.csv": Recording(
        "tests/dynamics/thrustTestSquareVariable_Batt1_2011-08-23-17-08-26_50Hz.csv",
        "eba502077f04266ffe791935e8a3cd736c90b7ebfb468043681d38dd44cc8299",
    ),
    "outdoor_flight.csv": Recording(
        "tests/dynamics/outdoorRvc4modelling_2011-09-30-11-23-11synced4.csv",
        "f12d100676ee9624c8ad2583e8a00df0ca0e0b725d0e0cbee988aa0ec4372800",
    ),
    "gps_static.csv": Recording(
        "tests/gps/arTest2Video-8_3_111-14_27_53_gps.csv",
        "de456b01bd5ef7f11b120adb265848f65d618c6827da72cd5d445f3aa5dbde7d",
    ),
    "ngs15992_16to17.sp3": Recording(
        "sim/enviroment/gps/ngs15992_16to17.sp3",
        "0e1b500753bda7e9eb6be3ea2d9118c37eadda9038ab596d820fab63c63f3414",
    ),
}

Condition = Literal["good", "altered", "missing"]


@dataclass(frozen=True)
class FileStatus:
    """State of a recording's file in a folder; ``sha256_found`` is None if the file is missing."""

    name: str
    path: Path
    sha256_expected: str
    sha256_found: str | None

    @property
    def condition(self) -> Condition:
        """Condition of the file: "good", "altered" (another hash) or "missing"."""
        if self.sha256_found is None:
            return "missing"
        return "good" if self.sha256_found == self.sha256_expected else "altered"


def data_folder() -> Path:
    """Return the folder of the public recordings: QRSIM_DATA_DIR if set, else one in the user's cache."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    if chosen:
        return Path(os.path.expanduser(chosen)).absolute()
    import platformdirs

    return Path(platformdirs.user_cache_dir("qrsim", appauthor=False)) / "recordings"


def file_status(name: str, folder: Path | None = None) -> FileStatus:
    """Return the status of the recording ``name`` in ``folder`` (default: ``data_folder()``): missing, altered or good,
    by its hash.

    Raises:
        UsageError: no recording has this name.
        RunError: the file cannot be read.
    """
    if name not in RECORDINGS:
        raise UsageError(f"no recording is called '{name}'{did_you_mean(name, RECORDINGS)}")
    path = (data_folder() if folder is None else folder) / name
    with os_error_as(RunError, f"cannot read {path}"):
        found = hashlib.sha256(read_bytes(path)).hexdigest() if path.exists() else None
    return FileStatus(name, path, RECORDINGS[name].sha256, found)


def data_file(name: str) -> Path:
    """Return the path of a recording in the data folder; raises an error if it is missing or its hash is wrong.

    Raises:
        UsageError: no recording has this name.
        RunError: the file is missing or altered.
    """
    status = file_status(name)
    if status.condition == "missing":
        raise RunError(
            f"the recording {name} is not in {status.path.parent}; 'qrsim data fetch' gets it"
            f" (or set {FOLDER_VARIABLE} to the folder that holds it)"
        )
    if status.condition == "altered":
        raise RunError(
            f"{status.path} is altered: expected sha256 {status.sha256_expected}, found {status.sha256_found};"
            " 'qrsim data fetch' replaces it"
        )
    return status.path


def fetch_file(name: str, folder: Path, progress_bar: object = None) -> Path:
    """Download a recording into ``folder`` and return its path; a good file is kept, an altered one replaced.

    Args:
        name: a key of RECORDINGS.
        folder: made where it does not exist.
        progress_bar: what pooch takes: an object with ``total``, ``update``, ``reset`` and ``close``.

    Raises:
        RunError: no answer, a wrong answer, or the folder cannot be written.
    """
    pooch = extras.load("data", "fetching recordings", "pooch")

    recording = RECORDINGS[name]
    with os_error_as(RunError, f"cannot make the folder {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    pooch.get_logger().setLevel("ERROR")
    store = pooch.create(folder, UPSTREAM, registry={name: recording.sha256}, urls={name: recording.url})
    downloader = pooch.HTTPDownloader(progressbar=progress_bar or False, timeout=TIMEOUT_S)
    try:
        return Path(store.fetch(name, downloader=downloader))
    # The library's network errors are OSErrors; a ValueError says that what came has another sha256.
    except (OSError, ValueError) as error:
        raise RunError(f"cannot fetch {name} from {recording.url}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Return one short line on why a download failed."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if getattr(error, "response", None) is not None or isinstance(error, ValueError):
        return str(error).splitlines()[0]
    return f"no answer ({type(error).__name__})"


def fetch_by_hand(names: list[str], folder: Path) -> list[str]:
    """Return lines of text that explain how to download recordings on another machine."""
    rows = [line for name in names for line in (f"  {RECORDINGS[name].url}", f"    as {folder / name}")]
    check = f"then check with: {FOLDER_VARIABLE}={shlex.quote(str(folder))} qrsim data where"
    return ["by hand, on a machine with network access, save", *rows, check]
