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
    """Return the worst verdict, the first row's reason for it, and the names of further rows with it."""
    counted = [row for row in rows if row.decides]
    worst: Verdict = max((row.verdict for row in counted), key=ORDER.index, default="marginal")
    if not counted:
        return "marginal", "nothing was flown"
    if worst == "go":
        return worst, "every criterion is met"
    first, *others = (row for row in counted if row.verdict == worst)
    also = f"; also {worst}: {', '.join(row.name for row in others)}" if others else ""
    return worst, f"{first.why}{also}"


def undecided(rows: Sequence[Row]) -> bool:
    """Return whether more runs could change the verdict."""
    return overall(rows)[0] != "no-go" and any(row.name in SEQUENTIAL and row.verdict == "marginal" for row in rows)


def judge(
    runs: Runs, criteria: CriteriaSpec, look: int | None, energy: bool = True, low_battery: float = 0.15
) -> list[Row]:
    """Return a row for each criterion that the nominal runs decide.

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
    """Return the error probability that a look may spend on "go" and on "no-go"; None for no decision."""
    if look is None:
        return None, None
    return (None if look == 0 else spent(look)), spent(look + 1)


def _share(hits: int, runs: int, limit: float, look: int | None) -> tuple[Verdict, float]:
    """Return the verdict on a share that must stay below a limit, and the share's upper bound."""
    for_go, for_no_go = _levels(look)
    bound = upper(hits, runs) if for_go is None else upper(hits, runs, for_go)
    if for_go is not None and bound < limit:
        return "go", bound
    if for_no_go is not None and lower(hits, runs, for_no_go) > limit:
        return "no-go", bound
    return "marginal", bound


def _loss(runs: Runs, criteria: CriteriaSpec, look: int | None) -> Row:
    """Return the row of the share of lost vehicles."""
    lost = runs["stopped"] > 0.0
    hits, total = int(lost.sum()), len(runs)
    verdict, bound = _share(hits, total, criteria.p_loss, look)
    worst, told = None, f"{total} runs, none lost: below {_percent(bound)}"
    if hits:
        worst = runs.loss(int(np.nanargmin(np.where(lost, runs["stopped_s"], np.nan))))
        told = f"{hits} of {total} runs lost ({_percent(hits / total)}){_kinds(runs, lost)}"
        told += f"; the earliest: {worst.text()}" if verdict == "no-go" else f"; the share is below {_percent(bound)}"
    if verdict == "marginal":
        needed = max(first_look(min(criteria.p_loss, UNFINISHED)), runs_needed(criteria.p_loss, hits, spent(1)))
        told += f"; about {needed} runs would decide {_percent(criteria.p_loss)}"
    return Row("loss", verdict, hits / total, bound, criteria.p_loss, "1", told, worst)


def _kinds(runs: Runs, lost: NumpyArray) -> str:
    """Return in words how runs were lost, with counts, empty batteries and the wind of departures; "" without any."""
    kinds = {"left the area": "left_area", "collided": "collided", "crashed": "crashed"}
    found = [f"{int((runs[name] > 0.0).sum())} {words}" for words, name in kinds.items() if (runs[name] > 0.0).any()]
    empty = int((lost & (runs["charge_end"] < CHARGE_NOISE)).sum())
    found += [f"the battery was empty in {empty}"] if empty else []
    away = runs["left_area"] > 0.0
    if away.any():
        found.append(f"the strongest wind of those that left was {np.nanmedian(runs['wind_max_m_s'][away]):.0f} m/s")
    return f": {', '.join(found)}" if found else ""


def _finished(runs: Runs, look: int | None, low_battery: float) -> Row:
    """Return the row of the share of runs that do not finish the mission."""
    missed = runs["not_finished"] > 0.0
    hits, total = int(missed.sum()), len(runs)
    verdict, bound = _share(hits, total, UNFINISHED, look)
    told = f"{total - hits} of {total} runs finish the mission; the share of the others is below {_percent(bound)}"
    worst = None
    if hits:
        taken = missed & (runs["failsafes"] > 0.0)
        told += f"; a failsafe took over in {int(taken.sum())}" if taken.any() else ""
        low = taken & (runs["charge_end"] <= low_battery + CHARGE_NOISE)
        told += f", with the battery low in {int(low.sum())}" if low.any() else ""
        run = int(np.flatnonzero(missed)[0])
        at = float(runs["failsafe_s"][run])
        worst = Moment(int(runs.seeds[run]), "", None, None if math.isnan(at) else at)
    return Row("finished", verdict, hits / total, bound, UNFINISHED, "1", told, worst)


def _reserve(runs: Runs, criteria: CriteriaSpec, look: int | None) -> Row:
    """Return the row of the charge at the end of the worst 5 % of runs."""
    left = np.where(runs["stopped"] > 0.0, np.nan, runs["charge_end"])
    if not np.isfinite(left).any():
        return Row(
            "reserve", "marginal", None, None, criteria.reserve, "1", "no run came to its end, so no charge counts"
        )
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
    told = (
        f"5 % of the runs end with less than {_percent(value)} of charge; the reserve is {_percent(criteria.reserve)}"
    )
    down = float(runs["down_s"][run])
    # A run that ends in the air has no time of its end.
    worst = Moment(int(runs.seeds[run]), "", None, None if math.isnan(down) else down)
    return Row("reserve", verdict, value, low if math.isfinite(low) else None, criteria.reserve, "1", told, worst)


def _margins(runs: Runs, criteria: CriteriaSpec) -> Iterator[Row]:
    """Yield the rows of distance margins, without those that no run has."""
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
    """Return the row of the smallest margin [m] over ``values``, one row per name in ``margins``."""
    smallest = np.fmin.reduce(values)
    value = quantile(smallest, WORST_MARGIN)
    low, _ = quantile_bounds(smallest, WORST_MARGIN)
    verdict: Verdict = "marginal"
    if len(runs) >= FEWEST:
        verdict = "go" if value > limit else "no-go" if value < max(0.0, 0.5 * limit) else "marginal"
    run = int(np.nanargmin(smallest))
    part = int(np.nanargmin(values[:, run]))
    worst = runs.moment(run, margins[part])
    words = {"ceiling_min": "the ceiling", "ground_min": "the ground", "obstacle_min": "an obstacle"}
    words |= {"fence_horizontal_min": "the sides of the area", "air_separation_min": "another vehicle in the air"}
    told = (
        f"{name}: 1 % of the runs come nearer than {value:.1f} m; wanted {limit:g} m; the nearest to "
        f"{words[margins[part]]} was {smallest[run]:.1f} m ({worst.text()})"
    )
    return Row(name, verdict, value, low if math.isfinite(low) else None, limit, "m", told, worst)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"
