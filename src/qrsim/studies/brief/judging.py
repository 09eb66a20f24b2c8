"""Verdicts on the runs of a brief: one row for each criterion, go, marginal or no-go."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.studies.brief.operation import CriteriaSpec
from qrsim.studies.brief.runs import Moment, Runs
from qrsim.studies.brief.statistics import (
    FEWEST,
    first_look,
    lower,
    quantile,
    quantile_bounds,
    runs_needed,
    spent,
    upper,
)
from qrsim.studies.brief.studying import UNFINISHED

Verdict = Literal["go", "marginal", "no-go"]
ORDER: tuple[Verdict, ...] = ("go", "marginal", "no-go")
# Share of the runs whose charge may be below the reserve, and whose margins may be below their criteria.
WORST_CHARGE, WORST_MARGIN = 0.05, 0.01
# Between a reported charge and the true one.
CHARGE_NOISE = 0.01
# What each criterion measures, and on which side of its limit a go is.
MEASURES = {
    "loss": ("runs lost", "below"),
    "finished": ("runs not finished", "below"),
    "reserve": ("charge at the end", "at least"),
    "fence": ("distance to the area's limits", "above"),
    "ground": ("height above the ground", "above"),
    "obstacle": ("distance to obstacles", "above"),
    "separation": ("distance between vehicles", "above"),
    "wind": ("wind with gusts", "below"),
    "gnss": ("time with good GNSS", "at least"),
}
# Places that margins are measured to.
PLACES = {
    "ceiling_min": "the ceiling",
    "ground_min": "the ground",
    "obstacle_min": "an obstacle",
    "fence_horizontal_min": "the sides of the area",
    "air_separation_min": "another vehicle in the air",
}
# Criteria that more runs decide.
SEQUENTIAL = ("loss", "finished", "reserve")


@dataclass(frozen=True)
class Row:
    """A criterion and its verdict.

    Attributes:
        name: of the criterion.
        verdict: go, marginal or no-go.
        value: measured share or quantile, None where there is none.
        bound: bound of it that the verdict compares, None where there is none.
        limit: of the criterion.
        unit: of the three.
        why: one sentence.
        worst: moment of the worst run, None where there is none.
        decides: whether it counts in the verdict of the brief.
    """

    name: str
    verdict: Verdict
    value: float | None
    bound: float | None
    limit: float | None
    unit: str
    why: str
    worst: Moment | None = None
    decides: bool = True


def overall(rows: Sequence[Row]) -> tuple[Verdict, str]:
    """Return the worst verdict of the criteria, and as text its reason, with other criteria that have this verdict."""
    counted = [row for row in rows if row.decides]
    worst: Verdict = max((row.verdict for row in counted), key=ORDER.index, default="marginal")
    if not counted:
        return "marginal", "nothing was flown"
    if worst == "go":
        return worst, "every criterion is met"
    first, *others = (row for row in counted if row.verdict == worst)
    also = f"; also {worst}: {', '.join(measured(row.name)[0] for row in others)}" if others else ""
    return worst, f"{first.why}{also}"


def measured(name: str) -> tuple[str, str]:
    """Return in words what a criterion measures, and on which side of its limit it is a go ("at least", ...)."""
    return MEASURES.get(name, (f"{name}: come home", "at least"))


def undecided(rows: Sequence[Row]) -> bool:
    """Return whether more runs could change the overall verdict."""
    return overall(rows)[0] != "no-go" and any(row.name in SEQUENTIAL and row.verdict == "marginal" for row in rows)


def judge(
    runs: Runs, criteria: CriteriaSpec, look: int | None, energy: bool = True, low_battery: float = 0.15
) -> list[Row]:
    """Return a row with a verdict for each criterion of the nominal runs at interim analysis ``look``.

    Args:
        runs: flown so far.
        criteria: of the operation.
        look: number of the look at which they are complete; None between two looks, which decide nothing.
        energy: whether the charge is judged.
        low_battery: charge at which a failsafe reacts.
    """
    if not len(runs):
        return []
    rows = [_loss(runs, criteria, look), _finished(runs, look, low_battery)]
    rows += [_reserve(runs, criteria, look)] if energy else []
    return [*rows, *_margins(runs, criteria)]


def _levels(look: int | None) -> tuple[float | None, float | None]:
    """Return the error probabilities for "go" and "no-go" at interim analysis ``look``; None: not to be decided."""
    if look is None:
        return None, None
    return (None if look == 0 else spent(look)), spent(look + 1)


def _share(hits: int, runs: int, limit: float, look: int | None) -> tuple[Verdict, float]:
    """Return verdict at interim analysis ``look`` and upper bound of a share of runs that must stay below a limit."""
    for_go, for_no_go = _levels(look)
    bound = upper(hits, runs) if for_go is None else upper(hits, runs, for_go)
    if for_go is not None and bound < limit:
        return "go", bound
    if for_no_go is not None and lower(hits, runs, for_no_go) > limit:
        return "no-go", bound
    return "marginal", bound


def _loss(runs: Runs, criteria: CriteriaSpec, look: int | None) -> Row:
    """Return the row with the verdict on the share of lost vehicles at interim analysis ``look``."""
    lost = runs["stopped"] > 0.0
    hits, total = int(lost.sum()), len(runs)
    verdict, bound = _share(hits, total, criteria.p_loss, look)
    worst, told = None, f"none of {total} runs lost; a share above {_percent(bound)} is ruled out"
    if hits:
        worst = runs.loss(int(np.nanargmin(np.where(lost, runs["stopped_s"], np.nan))))
        told = f"{_part(hits, total, 'lost', bound)}{_kinds(runs, lost)}{_usual_leg(runs, lost)}"
        told += f"; the {'earliest' if hits > 1 else 'place'}: {worst.text()}"
    if verdict == "marginal":
        needed = max(first_look(min(criteria.p_loss, UNFINISHED)), runs_needed(criteria.p_loss, hits, spent(1)))
        told += f"; too few runs: about {needed} are needed to judge the limit of {_percent(criteria.p_loss)}"
    return Row("loss", verdict, hits / total, bound, criteria.p_loss, "1", told, worst)


def _part(hits: int, total: int, words: str, bound: float) -> str:
    """Return a text such as "2 of 32 runs lost (6.2 %, could be up to 18 %)"; ``words`` says what happened to them."""
    most = f", could be up to {_percent(bound)}" if hits < total else ""
    return f"{hits} of {total} runs {words} ({_percent(hits / total)}{most})"


def _usual_leg(runs: Runs, lost: NumpyArray) -> str:
    """Return as text the leg on which most of the ``lost`` runs (a mask) were lost; "" if no leg is known."""
    legs = runs["stopped_leg"][lost]
    numbers, counts = np.unique(legs[np.isfinite(legs)].astype(int), return_counts=True)
    if not len(numbers) or lost.sum() < 2:
        return ""
    return f"; {counts.max()} of them on leg {numbers[np.argmax(counts)]}"


def _kinds(runs: Runs, lost: NumpyArray) -> str:
    """Return in words how the ``lost`` runs (a mask) were lost, with counts and winds; "" without lost runs."""
    kinds = {"left the area": "left_area", "collided": "collided", "crashed": "crashed"}
    found = [f"{int((runs[name] > 0.0).sum())} {words}" for words, name in kinds.items() if (runs[name] > 0.0).any()]
    empty = int((lost & (runs["charge_end"] < CHARGE_NOISE)).sum())
    found += [f"the battery was empty in {empty}"] if empty else []
    away = runs["left_area"] > 0.0
    if away.any():
        found.append(f"the strongest wind of those that left was {np.nanmedian(runs['wind_max_m_s'][away]):.0f} m/s")
    return f": {', '.join(found)}" if found else ""


def _finished(runs: Runs, look: int | None, low_battery: float) -> Row:
    """Return the row with the verdict, at interim analysis ``look``, on the share of runs that do not finish."""
    missed = runs["not_finished"] > 0.0
    hits, total = int(missed.sum()), len(runs)
    verdict, bound = _share(hits, total, UNFINISHED, look)
    told = f"all {total} runs finish the mission; a share above {_percent(bound)} that does not is ruled out"
    worst = None
    if hits:
        taken, lost = missed & (runs["failsafes"] > 0.0), missed & (runs["stopped"] > 0.0)
        late = missed & ~taken & ~lost
        told = _part(hits, total, "do not finish the mission", bound)
        told += f"; {int(lost.sum())} are lost" if lost.any() else ""
        told += f"; a failsafe takes over in {int(taken.sum())}" if taken.any() else ""
        low = taken & (runs["charge_end"] <= low_battery + CHARGE_NOISE)
        told += f", with the battery low in {int(low.sum())}" if low.any() else ""
        told += f"; {int(late.sum())} are still on their way when the run ends" if late.any() else ""
        run = int(np.flatnonzero(missed)[0])
        at = float(runs["failsafe_s"][run])
        worst = Moment(int(runs.seeds[run]), "", None, None if math.isnan(at) else at)
    return Row("finished", verdict, hits / total, bound, UNFINISHED, "1", told, worst)


def _reserve(runs: Runs, criteria: CriteriaSpec, look: int | None) -> Row:
    """Return the row with the verdict, at interim analysis ``look``, on the final charge of the worst 5 % of runs."""
    left = runs["charge_end"]
    # The charge of a lost run says nothing, unless it was the charge that ended it.
    left = np.where((runs["stopped"] > 0.0) & ~(left < CHARGE_NOISE), np.nan, left)
    ended = int(np.isfinite(left).sum())
    if not ended:
        return Row("reserve", "marginal", None, None, criteria.reserve, "1", "not judged: every run was lost")
    value = quantile(left, WORST_CHARGE)
    for_go, for_no_go = _levels(look)
    low, _ = quantile_bounds(left, WORST_CHARGE, spent(1) if for_go is None else for_go)
    _, high = quantile_bounds(left, WORST_CHARGE, spent(1) if for_no_go is None else for_no_go)
    verdict: Verdict = "marginal"
    if for_go is not None and low >= criteria.reserve:
        verdict = "go"
    elif for_no_go is not None and high < 0.5 * criteria.reserve:
        verdict = "no-go"
    run = int(np.nanargmin(left))
    enough = value >= criteria.reserve
    told = f"19 of 20 runs end with {_percent(value)} of charge or more" if enough else _empty(value)
    told += f"; the reserve is {_percent(criteria.reserve)}"
    if verdict == "marginal" and enough:
        told += f"; {ended} runs that were not lost are too few to be sure"
    down = float(runs["down_s"][run])
    # A run that ends in the air has no time of its end.
    worst = Moment(int(runs.seeds[run]), "", None, None if math.isnan(down) else down)
    return Row("reserve", verdict, value, low if math.isfinite(low) else None, criteria.reserve, "1", told, worst)


def _margins(runs: Runs, criteria: CriteriaSpec) -> Iterator[Row]:
    """Yield the rows with verdicts on distance margins, without margins that no run has."""
    asked = {
        "fence": (("fence_horizontal_min", "ceiling_min"), criteria.fence),
        "ground": (("ground_min",), criteria.ground),
        "obstacle": (("obstacle_min",), criteria.obstacle),
        "separation": (("air_separation_min",), criteria.separation),
    }
    for name, (margins, limit) in asked.items():
        values = np.array([runs[f"{margin}_m"] for margin in margins])
        if np.isfinite(values).any():
            yield _margin(runs, name, margins, values, limit)


def _margin(runs: Runs, name: str, margins: tuple[str, ...], values: NumpyArray, limit: float) -> Row:
    """Return the row with the verdict on the smallest of ``margins``; ``values`` [m] has one row for each."""
    smallest = np.fmin.reduce(values)
    value = quantile(smallest, WORST_MARGIN)
    low, _ = quantile_bounds(smallest, WORST_MARGIN)
    verdict: Verdict = "marginal"
    if len(runs) >= FEWEST:
        verdict = "go" if value > limit else "no-go" if value < max(0.0, 0.5 * limit) else "marginal"
    run = int(np.nanargmin(smallest))
    part = int(np.nanargmin(values[:, run]))
    worst = runs.moment(run, margins[part])
    near = int((smallest < limit).sum())
    told = (
        f"{near or 'none'} of {len(runs)} runs {'comes' if near < 2 else 'come'} nearer than {limit:g} m to "
        f"{' or '.join(PLACES[margin] for margin in margins)}; the nearest is {abs(smallest[run]):.1f} m "
        f"{'beyond' if smallest[run] < 0.0 else 'from'} {PLACES[margins[part]]} ({worst.text()})"
    )
    told += "; crashes count as lost runs" if name == "ground" and (runs["crashed"] > 0.0).any() else ""
    return Row(name, verdict, value, low if math.isfinite(low) else None, limit, "m", told, worst)


def _empty(value: float) -> str:
    """Return in words that the worst 5 % of runs end with this charge (0 to 1) or less."""
    return f"1 of 20 runs ends with {'no charge' if value < CHARGE_NOISE else f'{_percent(value)} of charge or less'}"


def _percent(share: float) -> str:
    """Return a share as a percentage in text."""
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"
