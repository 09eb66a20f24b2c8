"""The parts of the validation, and a runner for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from qrsim.errors import RunError, UsageError, did_you_mean
from qrsim.files import Content, recordings
from qrsim.studies.validate import drifts, gnss, imu, receivers, rotation, thrust, translation, turbulence, wind_field
from qrsim.studies.validate.report import Outcome, Part

PARTS: dict[str, Part] = {
    part.name: part
    for part in (
        thrust.PART,
        rotation.PART,
        translation.PART,
        turbulence.PART,
        wind_field.PART,
        gnss.PART,
        receivers.PART,
        drifts.PART,
        imu.PART,
    )
}


@dataclass(frozen=True)
class Result:
    """A part with its outcome, or the reason it was skipped."""

    part: Part
    outcome: Outcome | None
    skipped: str = ""

    def to_json(self) -> Content:
        """Return the result of a part of the report as a dict for JSON, without its pictures."""
        head = {"title": self.part.title, "answers": self.part.answers, "recordings": list(self.part.recordings)}
        if self.outcome is None:
            return head | {"passed": None, "skipped": [self.skipped]}
        return head | {
            "passed": self.outcome.passed,
            "skipped": self.outcome.skipped,
            "method": self.outcome.method,
            "reading": self.outcome.reading,
            "checks": [check.to_json() for check in self.outcome.checks],
            "findings": [finding.to_json() for finding in self.outcome.findings],
            "numbers": self.outcome.numbers,
        }


def choose(names: Sequence[str]) -> list[Part]:
    """Return the named parts of the report, each once and in its order; all if no name is given.

    Raises:
        UsageError: a name that no part has.
    """
    for name in names:
        if name not in PARTS:
            raise UsageError(f"--only {name}: no such part{did_you_mean(name, PARTS)}")
    return [part for name, part in PARTS.items() if not names or name in names]


def find_recordings(parts: Sequence[Part]) -> dict[str, Path]:
    """Return name -> path of the public recordings that the parts need and that are on this machine.

    Raises:
        RunError: a recording was altered or cut off, or cannot be read.
    """
    names = dict.fromkeys(name for part in parts for name in part.recordings)
    found = {}
    for name in names:
        if recordings.file_status(name).condition != "missing":
            found[name] = recordings.data_file(name)
    return found


def run_parts(
    parts: Sequence[Part], found: dict[str, Path], full: bool = True, done: Callable[[Part], None] | None = None
) -> list[Result]:
    """Run parts of the report in order, in full or quickly; skip a part without its recordings. ``done``: called after
    each.

    Raises:
        RunError: no part could be run.
    """
    results = []
    for part in parts:
        missing = [name for name in part.recordings if name not in found]
        if missing:
            results.append(Result(part, None, _missing_reason(missing)))
        else:
            results.append(Result(part, part.run(found, full)))
        if done:
            done(part)
    if all(result.outcome is None for result in results):
        raise RunError("nothing to do: " + "; ".join(f"{result.part.name}: {result.skipped}" for result in results))
    return results


def _missing_reason(missing: Sequence[str]) -> str:
    """Return why a part of the report is skipped: recordings that are missing, and how to fetch them."""
    folder = recordings.data_folder()
    return (
        f"{', '.join(missing)} not found in {folder}; 'qrsim data fetch' gets the recordings"
        f" (or set {recordings.FOLDER_VARIABLE} to the folder that holds them)"
    )
