"""Result of an identification: the vehicle for scenarios and the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from qrsim.errors import RunError, os_error_as
from qrsim.files import Content
from qrsim.files.atomic import write_atomically
from qrsim.scenarios.reading import dump_yaml
from qrsim.studies.flight_logs.excitation import Excitation
from qrsim.studies.flight_logs.signals import SIGNALS
from qrsim.studies.identify.constants import aspects_of, unit_of
from qrsim.studies.identify.fit import Answer, Question
from qrsim.studies.identify.problem import Piece
from qrsim.studies.identify.verdicts import Verdict, channels_in, coloured_channels


@dataclass(frozen=True)
class Result:
    """An identification.

    Attributes:
        question, answer: what was asked and found.
        pieces: the training part of each log.
        held_out: the scores of each log's held-out part.
        whiteness: of each log's residuals.
        wall_s: [s] that it took, compiling included.
        train: share of the rows that was fitted.
        verdicts: on every constant of the vehicle.
        excitations: of the training part of each log.
    """

    question: Question
    answer: Answer
    pieces: Sequence[Piece]
    held_out: Sequence[Content]
    whiteness: Sequence[dict[str, dict[str, float]]]
    wall_s: float
    train: float
    verdicts: Mapping[str, Verdict]
    excitations: Sequence[Excitation]

    def constants(self) -> dict[str, Content]:
        """Return name -> value, 95 % interval and unit, for each identified constant."""
        found = {}
        for name in (name for name, verdict in self.verdicts.items() if verdict.status == "identified"):
            low, high = self.answer.covariance.interval(name)
            found[name] = {
                "value": self.answer.values[name],
                "low": low,
                "high": high,
                "start": self.question.start[name],
                "unit": unit_of(name),
            }
        return found

    def effective(self) -> dict[str, list[str]]:
        """Return constant -> channels with residuals that are not white, which make the constant doubtful.

        These have motion that the equations leave out: the constants are those with which the equations come nearest
        to such flights, and their intervals are of that, not of what the vehicle has.
        """
        found = {name: coloured_channels(name, self.question.separate, self.whiteness) for name in self.constants()}
        return {name: channels for name, channels in found.items() if channels}

    def effective_in_words(self) -> list[str]:
        """Return a sentence for each group of constants that the same channels' residuals make doubtful."""
        names: dict[tuple[str, ...], list[str]] = {}
        for name, channels in self.effective().items():
            names.setdefault(tuple(channels), []).append(name)
        return [
            f"effective constants: {', '.join(each)}: the residual of {', '.join(channels)} is not white, so something "
            "moves the vehicle that the equations do not have; intervals are of what fits such flights best"
            for channels, each in names.items()
        ]

    def other_verdicts(self) -> dict[str, list[str]]:
        """Return verdict -> names of constants, for the constants that were not identified."""
        found: dict[str, list[str]] = {}
        for name, verdict in self.verdicts.items():
            if verdict.status == "fitted":
                found.setdefault(f"fitted, but not known one by one: {verdict.why}", []).append(name)
            elif verdict.status == "held":
                found.setdefault(f"held at its start: {verdict.why}", []).append(name)
        return found

    def to_json(self) -> Content:
        """Return the result of an identification as a dict for JSON."""
        return {
            "constants": self.constants(),
            "effective": self.effective(),
            "verdicts": {
                name: {
                    "status": each.status,
                    "value": self.answer.values[name],
                    "start": self.question.start[name],
                    "why": each.why,
                }
                for name, each in self.verdicts.items()
            },
            "trained_on_share": self.train,
            "wall_s": round(self.wall_s, 2),
            "evaluations": self.answer.evaluations,
            "logs": [
                {
                    "file": str(piece.log.source),
                    "kind": piece.log.kind,
                    "notes": piece.log.notes,
                    "nuisances": self._nuisance_values(i),
                    "channels": self.channels(i),
                    "standing_still_share": self.excitations[i].still,
                    "noise": self.answer.noise[i],
                    "held_out": self.held_out[i],
                    "whiteness": self.whiteness[i],
                }
                for i, piece in enumerate(self.pieces)
            ],
        }

    def channels(self, i: int) -> dict[str, Content]:
        """Return signal name -> its movement in log ``i``, and whether it served to identify constants.

        ``identified`` is for measured signals alone: an aspect that the log shows has a constant that was identified.
        """
        known = {
            channel
            for name, verdict in self.verdicts.items()
            if verdict.status == "identified"
            for aspect in aspects_of(name, self.question.separate)
            if aspect in self.excitations[i].shown
            for channel in channels_in(aspect)
        }
        found = {}
        for name, movement in self.excitations[i].movements.items():
            found[name] = {
                "std": movement.std,
                "noise": movement.noise,
                "ratio": movement.ratio,
                "moves": movement.moves,
                "unit": SIGNALS[name].unit,
            }
            if not SIGNALS[name].command:
                found[name]["identified"] = name in known
        return found

    def _nuisance_values(self, i: int) -> dict[str, Content]:
        """Return the nuisance parameters (delay, trims, wind) of log ``i``, with units and intervals."""
        content: dict[str, Content] = {}
        for name, value in self.answer.nuisances[i].items():
            content[name] = {"value": value, "unit": unit_of(name)}
            names = self.answer.covariance.names
            if f"{name}@{i}" in names and not self.answer.covariance.lost[names.index(f"{name}@{i}")]:
                content[name]["low"], content[name]["high"] = self.answer.covariance.interval(f"{name}@{i}")
        return content

    def vehicle(self) -> Content:
        """Return the identified vehicle as scenario content."""
        kind = "quadrotor" if self.question.separate else "pelican"
        return {"type": kind, **{name: float(value) for name, value in self.answer.values.items()}}

    def yaml(self, path: Path) -> str:
        """Return the text of the vehicle file: YAML with comments; ``path`` is named in them."""
        logs = ", ".join(piece.log.source.name for piece in self.pieces)
        head = (
            f"# Identified by 'qrsim identify' from {logs}: {', '.join(self.constants()) or 'no constant by itself'}.\n"
            "# All others: see 'verdicts' below.\n"
            f"# In a scenario:  fleets: {{NAME: {{vehicle: {{file: {path.name}}}}}}}\n"
        )
        return head + dump_yaml({"vehicle": self.vehicle(), "identified": rounded(self.to_json())})


def rounded(item: object) -> object:
    """Round all numbers in nested dicts and lists to 6 digits, for reading."""
    if isinstance(item, Mapping):
        return {key: rounded(value) for key, value in item.items()}
    if isinstance(item, list | tuple):
        return [rounded(value) for value in item]
    return float(f"{item:.6g}") if isinstance(item, float) else item


def write_text(path: Path, content: str | bytes) -> None:
    """Write a file atomically.

    Raises:
        RunError: it cannot be written.
    """
    with os_error_as(RunError, f"cannot write {path}"):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content if isinstance(content, bytes) else content.encode())
