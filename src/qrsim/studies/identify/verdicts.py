"""Verdict on each constant: identified, fitted but not determined alone, or held at its start.

Before the fit those are held whose motion the logs do not show. After it those that no fit determined, that ended at a
bound or so far from their start that their prior cannot be said to hold them, or that no vehicle can have; and where
all of that is in order, those of an aspect in which the held-out part is predicted no better than by the start. The fit
is repeated without them until nothing is left to object to.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from qrsim.errors import LogError, RunError
from qrsim.files import Content
from qrsim.studies.flight_logs import FlightLog
from qrsim.studies.flight_logs.excitation import ASPECTS, Excitation, described
from qrsim.studies.identify.constants import CONSTANTS, PITCH, aspects_of
from qrsim.studies.identify.fit import Answer, Question, width_of
from qrsim.studies.identify.plausible import implausible

Status = Literal["identified", "fitted", "held"]
# A constant that its prior holds is within so many standard deviations of it.
WITHIN_PRIOR = 1.0
# An aspect may be kept whose held-out channels are predicted better in the mean and none worse by more than this.
HARDLY_WORSE = 0.01
# Ljung and Box's probability below which a residual is not white: of noise, ten channels of 10 000 logs pass it.
NOT_WHITE = 1e-6


@dataclass(frozen=True)
class Verdict:
    """Verdict on one constant.

    Attributes:
        status: identified; fitted, but its own value is not known; held at its start.
        why: the reason in words, "" for one that was identified.
    """

    status: Status
    why: str = ""


def channels_in(aspect: str) -> tuple[str, ...]:
    """Return the measured channels in which the error must fall for an aspect of motion to be identified."""
    return ("yaw", *ASPECTS[aspect].channels) if aspect == "yaw" else ASPECTS[aspect].channels


def coloured_channels(
    constant: str, separate: bool, whiteness: Sequence[Mapping[str, Mapping[str, float]]]
) -> list[str]:
    """Return those channels a constant affects that have residuals which are not white, in any log.

    Args:
        constant: its name.
        separate: pitch has constants of its own.
        whiteness: of each log what ``scores.whiteness`` says of each channel.
    """
    aspects = aspects_of(constant, separate)
    # Velocities are simulated from angles that are simulated.
    more = () if set(aspects) <= {"roll", "pitch", "yaw"} else ("roll", "pitch")
    channels = dict.fromkeys(channel for aspect in (*aspects, *more) for channel in channels_in(aspect))
    return [
        channel
        for channel in channels
        if any(channel in each and each[channel]["ljung_box_p"] < NOT_WHITE for each in whiteness)
    ]


def not_shown(names: Sequence[str], separate: bool, excitations: Sequence[Excitation]) -> dict[str, str]:
    """Return constant -> reason, for constants that no log excites; ``separate``: pitch differs from roll."""
    held = {}
    for name in names:
        aspects = aspects_of(name, separate)
        if any(aspect in each.shown for each in excitations for aspect in aspects):
            continue
        reasons = dict.fromkeys(each.lacking[aspect] for each in excitations for aspect in aspects)
        # Where one aspect is there and another is not, what is there says why.
        told_why = [why for why in reasons if not why.startswith("no ")] or list(reasons)
        held[name] = "; ".join(told_why)
    return held


def objections(answer: Answer, question: Question) -> dict[str, str]:
    """Return constant -> reason, for fitted constants that must not be written to the vehicle file."""
    fitted = tuple(name for name in question.constants if name not in question.held)
    found = implausible(answer.values, fitted)
    for name in fitted:
        k = answer.covariance.names.index(name)
        moved = abs(answer.values[name] - question.start[name])
        # The standard deviation, were all else known.
        least = abs(question.start[name] or 1.0) / math.sqrt(max(float(answer.covariance.information[k]), 1e-300))
        if name in answer.at_bounds:
            found[name] = f"its fit ended at {answer.values[name]:.4g}, the bound of its search"
        elif answer.covariance.lost[k] or answer.covariance.information[k] <= 0.0:
            found[name] = answer.left.get(name, "too few parts of the logs show it")
        elif name in answer.left and moved > WITHIN_PRIOR * width_of(name, question):
            found.setdefault(name, f"its fit went to {answer.values[name]:.4g}, and {answer.left[name]}")
        elif name in answer.left and least > 0.5 * width_of(name, question):
            found.setdefault(name, f"too little excitation: {answer.left[name]}")
    return found


def worse(
    answer: Answer,
    question: Question,
    excitations: Sequence[Excitation],
    scores: Sequence[Content],
) -> tuple[dict[str, str], dict[str, str]]:
    """Return (rejected, doubtful) constants by their held-out errors, each as constant -> reason.

    Returns:
        Those to hold, and those of aspects that are better in the mean while the worst channel is hardly worse: such
        constants are kept, but not called identified.
    """
    hold: dict[str, str] = {}
    keep: dict[str, str] = {}
    for name in question.constants:
        if name in question.held:
            continue
        for excitation, score in zip(excitations, scores, strict=True):
            for aspect in aspects_of(name, question.separate):
                ratios = _ratios(aspect, score) if aspect in excitation.shown else {}
                if all(ratio < 1.0 for ratio in ratios.values()):
                    continue
                harmless = max(ratios.values()) <= 1.0 + HARDLY_WORSE and math.prod(ratios.values()) < 1.0
                (keep if harmless else hold)[name] = _describe_losses(ratios)
    return hold, {name: why for name, why in keep.items() if name not in hold}


def _ratios(aspect: str, score: Content) -> dict[str, float]:
    """Return channel -> held-out error divided by that with the initial constants, for an aspect's channels."""
    before, after = score["start"], score["identified"]
    found = {}
    for channel in channels_in(aspect):
        if channel in after:
            known = math.isfinite(after[channel]) and before[channel] > 0.0
            found[channel] = after[channel] / before[channel] if known else math.inf
    return found


def _describe_losses(ratios: Mapping[str, float]) -> str:
    """Return in words the channels with held-out errors that did not fall; ``ratios`` are after / before."""
    failed = ", ".join(
        f"{channel} {100.0 * (ratio - 1.0):.3g} % above" if math.isfinite(ratio) else f"{channel} not predicted"
        for channel, ratio in ratios.items()
        if not ratio < 1.0
    )
    return f"held-out error no lower than the start's: {failed}"


def verdicts_of(
    answer: Answer, question: Question, held: Mapping[str, str], doubtful: Mapping[str, str]
) -> dict[str, Verdict]:
    """Return constant -> verdict; ``held`` ones keep the initial value, ``doubtful`` ones are only called fitted."""
    found = {}
    for name in CONSTANTS:
        if name in PITCH and not question.separate:
            continue
        if name not in question.constants:
            found[name] = Verdict(
                "held", "given" if name == "mass" else "not asked for, or no signals of it in the logs"
            )
        elif name in held:
            found[name] = Verdict("held", held[name])
        elif name in answer.left:
            found[name] = Verdict("fitted", answer.left[name])
        elif name in doubtful:
            found[name] = Verdict("fitted", doubtful[name])
        else:
            found[name] = Verdict("identified")
    return found


def refuse_unexcited(logs: Sequence[FlightLog], excitations: Sequence[Excitation], held: Mapping[str, str]) -> None:
    """Raise LogError if none of the logs excites any constant.

    Raises:
        LogError: says for each log whether it stood on the ground; its details are how much each signal moves.
    """
    message, details = described(logs, excitations)
    reasons: dict[str, list[str]] = {}
    for name, why in held.items():
        reasons.setdefault(why, []).append(name)
    raise LogError(message, details + [f"  {', '.join(names)}: {why}" for why, names in reasons.items()])


def refuse_useless(logs: Sequence[FlightLog], held: Mapping[str, str]) -> None:
    """Raise RunError with the reasons, when the fit left no usable constant; ``held``: constant -> reason.

    Raises:
        RunError: with the reason for each constant.
    """
    reasons: dict[str, list[str]] = {}
    for name, why in held.items():
        reasons.setdefault(why, []).append(name)
    named = ", ".join(str(log.source) for log in logs)
    told = "; ".join(f"{', '.join(names)}: {why}" for why, names in reasons.items())
    raise RunError(f"{named}: no constant was identified, and nothing is written; {told}")
