"""A folder of run folders: the episodes of one server session, in order."""

from __future__ import annotations

import json
import re
from pathlib import Path

from qrsim.errors import RunError, UsageError, os_error_as
from qrsim.files import Content
from qrsim.runs.layout import FORMAT, RUN_FILE, utc_now

EPISODES_FILE = "episodes.json"
_MOST_NAMED = 4


def episode_name(number: int) -> str:
    """Return the name of the run folder of an episode, counted from 1."""
    return f"episode-{number:04d}"


class EpisodesWriter:
    """Names the run folders of episodes, and keeps a list of them; not thread-safe."""

    def __init__(self, folder: Path, content: Content):
        """Use ``EpisodesWriter.create``."""
        self.folder, self._content = folder, content

    @classmethod
    def create(cls, folder: Path, scenario: str) -> EpisodesWriter:
        """Create a new folder for the episodes of a server session with a scenario; return its writer.

        Raises:
            RunError: it exists, or cannot be written.
        """
        with os_error_as(RunError, f"cannot create the folder {folder}"):
            folder.mkdir(parents=True)
        return cls(folder, {"format": FORMAT, "scenario": scenario, "started": utc_now(), "episodes": []})

    def begin(self, seed: int) -> Path:
        """Record the next episode, flown with ``seed``, in the folder's list; return the path of its run folder.

        Raises:
            RunError: the list cannot be written.
        """
        from qrsim.files.atomic import write_atomically

        episodes = self._content["episodes"]
        name = episode_name(len(episodes) + 1)
        episodes.append({"folder": name, "seed": seed, "started": utc_now()})
        text = json.dumps(self._content, indent=2, ensure_ascii=False)
        with os_error_as(RunError, f"cannot write in {self.folder}"):
            write_atomically(self.folder / EPISODES_FILE, f"{text}\n".encode())
        return self.folder / name


def episode_folders(folder: Path) -> list[Path]:
    """Return the run folders in a folder of episodes, in order, even if its list of them is incomplete."""
    found = [(re.fullmatch(r"episode-(\d{4,})", path.name), path) for path in folder.iterdir()]
    numbered = sorted((int(match[1]), path) for match, path in found if match and (path / RUN_FILE).is_file())
    return [path for _, path in numbered]


def holds_episodes(folder: Path) -> bool:
    """Return whether a folder holds episodes of a server session, each a run folder, in place of a single run."""
    return (folder / EPISODES_FILE).is_file()


def named(folders: list[Path]) -> str:
    """Return the names of the first few folders as text for messages."""
    return ", ".join(str(path) for path in folders[:_MOST_NAMED]) + (", ..." if len(folders) > _MOST_NAMED else "")


def which_one(folder: Path, folders: list[Path]) -> UsageError:
    """Return the error for a folder of episodes, several or none, that was given where a single run is needed."""
    if not folders:
        return UsageError(f"{folder} holds no episodes")
    return UsageError(f"{folder} holds {len(folders)} episodes, each a run folder: take one of {named(folders)}")
