"""``qrsim slam --vehicles``: what goes with several vehicles, and what is told of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from qrsim.errors import UsageError
from qrsim.files import Content

if TYPE_CHECKING:
    from qrsim.runs import Run
    from qrsim.studies.slam.cooperative import CooperativeSlam

MEANING = {
    "white": "white",
    "own_as_white": "own, taken for white",
    "own_as_own_states": "own, as states of each",
    "shared_as_white": "shared, taken for white",
    "shared_as_own_states": "shared, as states of each",
    "shared_as_one_state": "shared, as one state of all",
}


def check_together(vehicles: int, graph: str, of_run: bool, given: Sequence[str]) -> None:
    """Raise UsageError for options (``given``) that several vehicles cannot have; ``of_run``: of a run.

    Args:
        vehicles: how many.
        graph: of the command.
        of_run: whether they are those of a run.
        given: names of the options that go with one vehicle only, as far as they were given.

    Raises:
        UsageError: too many vehicles or none, or another option that does not go with them.
    """
    if vehicles < 1:
        raise UsageError(f"--vehicles {vehicles}: expected a positive number")
    if vehicles == 1:
        return
    from qrsim.studies.slam.team import MOST_VEHICLES

    if not of_run and vehicles > MOST_VEHICLES:
        raise UsageError(f"--vehicles {vehicles}: expected at most {MOST_VEHICLES}")
    if graph != "gnss":
        raise UsageError("--vehicles: several are solved in --graph gnss only")
    for name in given[:1]:
        raise UsageError(f"--{name}: not with several --vehicles")


def numbers_of_run(found: CooperativeSlam) -> Content:
    """Return the errors [m] of a solved run of several vehicles as a dict for JSON; None for undefined ones."""
    import math

    import numpy as np

    rmse = found.landmark_rmse_m
    places = [[None if math.isnan(axis) else axis for axis in place] for place in found.landmarks_ned.tolist()]
    spread = np.sqrt(np.einsum("tnini->nti", found.position_covariance))
    return {
        "vehicles": [flight.name for flight in found.flights],
        "states": len(found.time),
        "iterations": found.iterations,
        "converged": found.converged,
        "ranges_between": int(found.between.counts.sum()),
        "trajectory_rmse_m": found.trajectory_rmse_m.tolist(),
        "relative_rmse_m": found.relative_rmse_m,
        "landmark_rmse_m": None if math.isnan(rmse) else rmse,
        "position_std_ned_m": spread.tolist(),
        "landmarks_ned": places,
        "determined": found.determined.tolist(),
    }


def solve_run_together(run: Run, vehicles: int, states: Literal["full", "poses"]) -> tuple[CooperativeSlam, Content]:
    """Solve the first ``vehicles`` vehicles of a run together; return the solution and its errors by name.

    Raises:
        UsageError: the run has fewer vehicles.
    """
    from qrsim.studies.slam.team_run import cooperative_from_run

    if vehicles > len(run.vehicles):
        raise UsageError(f"--vehicles {vehicles}: {run.folder} has {len(run.vehicles)}: {', '.join(run.vehicles)}")
    found = cooperative_from_run(run, vehicles=run.vehicles[:vehicles], states=states)
    return found, numbers_of_run(found)


def text_of_run(found: CooperativeSlam, numbers: Content) -> str:
    """Return the errors of a solved run of several vehicles as text."""
    count = f"{len(found.flights)} vehicles, {numbers['states']} states"
    lines = [f"{count}, {numbers['ranges_between']} ranges to each other", ""]
    for flight, error in zip(found.flights, numbers["trajectory_rmse_m"], strict=True):
        lines.append(f"trajectory RMSE {error:8.3f} m  {flight.name}")
    lines.append(f"relative RMSE   {numbers['relative_rmse_m']:8.3f} m")
    if numbers["landmark_rmse_m"] is not None:
        known = int(found.determined.sum())
        lines.append(f"landmark RMSE   {numbers['landmark_rmse_m']:8.3f} m, of {known} that are determined")
    return "\n".join(lines)


def text_of_study(result: Content) -> str:
    """Return the errors of the first vehicle alone and in the team, of a study, as text."""
    count = f"{result['seeds']} flight{'s' if result['seeds'] > 1 else ''}"
    lines = [f"{result['vehicles']} vehicles, {count} of {result['duration_s']:g} s each", ""]
    lines.append(f"  {'RMSE [m], mean over flights':<36} {'alone':>8} {'together':>8} {'relative':>8}   p of the gain")
    for name, found in result["cases"].items():
        means = " ".join(f"{found[part]['mean']:8.3f}" for part in ("alone_m", "together_m", "relative_m"))
        chance = f"   {found['gain_m']['p']:.2g}" if found["gain_m"] else ""
        lines.append(f"  {'errors ' + MEANING[name]:<36} {means}{chance}")
    left = sum(found["not_converged"] for found in result["cases"].values())
    return "\n".join(lines) + (f"\n\n  not converged: {left} of the solutions" if left else "")
