"""The learner's view of a task: which observations a policy takes, how often it decides, and how far its actions go."""

from __future__ import annotations

import numpy as np

from qrsim.envs import VERSION
from qrsim.envs.batch import Batch
from qrsim.envs.functional import Functional
from qrsim.errors import UsageError
from qrsim.tasks.agents import still
from qrsim.tasks.learned import View, observed_names
from qrsim.tasks.search import Search
from qrsim.tasks.simple import is_direct
from qrsim.tasks.teams import side_of_fleet

# Wanted time between two decisions [s], and between those of rates and motors, which no vehicle stabilises. A task with
# longer steps has one for each.
DECISION, DIRECT_DECISION = 0.1, 0.02
# Change of an action for each unit of a network's output, by the name of the number; of others 1.
REACHES = {"pitch": 0.3, "roll": 0.3, "throttle": 0.2, "yaw_rate": 0.05}
# The same of body rates and of the speed of a rotor.
RATE_REACHES, ROTOR_REACH = {"roll_rate": 0.3, "pitch_rate": 0.3, "throttle": 0.2, "yaw_rate": 0.1}, 0.1
# What is commanded in the vehicle's own axes, which makes a policy turn with its heading.
BODY = ("pitch", "roll")
# A pursuer sees and moves relative to the direction of the first mouse, as it looks alike from all sides.
AHEAD_OF_MOUSE = ("cat_0_offset_north", "cat_0_offset_east")
AHEAD, LEVEL = ("mouse_0_offset_north", "mouse_0_offset_east"), ("velocity_north", "velocity_east")
# Beginnings of the names of observed errors, whose integral makes up for a constant wind.
INTEGRATED = ("to_", "wanting_")
# What is never commanded: a battery is full.
GIVEN = ("battery",)


def view_of(functional: Functional, integral: bool = False, fleet: str | None = None) -> View:
    """Return how a learner sees this task: the network's inputs and outputs, and the time between decisions.

    Args:
        functional: the task.
        integral: the integral of the offset to the goal, or of the missing velocity, is an input too.
        fleet: name of the one that learns, of several.

    Raises:
        UsageError: a policy of this kind cannot fly the task, or it does not say which fleet learns.
    """
    play, name = functional.play, functional.name
    if play.task.hands_in:
        raise UsageError(f"{name}: its score is of an answer that agents hand in, which a learned policy does not give")
    several = len(play.sides) > 1
    if several and fleet is None:
        fleets = ", ".join(side.fleet for side in play.sides)
        raise UsageError(f"{name}: agents are of the fleets {fleets}; choose the one that learns by --fleet")
    if not several and fleet is not None:
        raise UsageError(f"--fleet {fleet}: {name} has agents of {play.sides[0].fleet} only")
    side = side_of_fleet(play.sides, fleet)
    try:
        observed = observed_names(play, fleet)
    except UsageError as error:
        hint = "; task.observes=likeliest gives numbers" if isinstance(play.task, Search) else ""
        raise UsageError(f"{name}: {error}{hint}") from None
    acts = tuple(axis.name for axis in side.axes)
    direct = is_direct(play.task)
    turns = "yaw" in observed and (direct or all(axis in acts for axis in BODY))
    towards = next((pair for pair in (AHEAD, AHEAD_OF_MOUSE) if pair[0] in observed), None)
    chases = towards is not None and all(axis in acts for axis in LEVEL)
    summed = tuple(number for number, name in enumerate(observed) if name.startswith(INTEGRATED)) if integral else ()
    if integral and not summed:
        raise UsageError(f"{name}: it observes no offset to a goal or velocity that an integral could be taken of")
    names = (*observed, *(f"sum_{observed[number]}" for number in summed))
    pairs = tuple(
        (number, names.index(name.removesuffix("north") + "east"))
        for number, name in enumerate(names)
        if (turns or chases) and name.endswith("_north") and name.removesuffix("north") + "east" in names
    )
    # An offset to the goal says more than a position, and what turns with the heading needs none.
    goal = any(each.startswith("to_") for each in observed)
    left_out = tuple(name for name in observed if (goal and name.startswith("position_")) or (turns and name == "yaw"))
    flown = tuple(number for number, act in enumerate(acts) if act not in GIVEN)
    return View(
        task=name,
        version=VERSION,
        seconds=_seconds(DIRECT_DECISION if direct else DECISION, play.task.period, play.steps),
        observed=observed,
        acts=acts,
        kept=tuple(number for number, each in enumerate(names) if each not in left_out),
        pairs=pairs,
        yaw=observed.index("yaw") if turns else None,
        flown=flown,
        centre=tuple(round(value, 6) for value in still(side.axes)),
        reach=tuple(_reach(act, direct) for act in acts),
        ahead=(observed.index(towards[0]), observed.index(towards[1])) if chases and towards is not None else None,
        fleet=fleet if several else None,
        turned=(flown.index(acts.index(LEVEL[0])), flown.index(acts.index(LEVEL[1]))) if chases else None,
        summed=summed,
    )


def _reach(act: str, direct: bool) -> float:
    """Return the change of the action's number ``act`` for each unit that a network returns."""
    if not direct:
        return REACHES.get(act, 1.0)
    return RATE_REACHES.get(act, ROTOR_REACH)


def _seconds(wanted: float, period: float, steps: int) -> float:
    """Return the time [s] between decisions: a multiple of ``period`` [s] that divides the episode's ``steps``."""
    most = max(1, round(wanted / period))
    count = next(count for count in range(most, 0, -1) if steps % count == 0)
    return float(np.round(period * count, 9))


def batch_of(scenario: object, size: int, overrides: list[str], view: View) -> Batch:
    """Return ``size`` episodes of a scenario in a batch, with one step per decision of the view."""
    return Batch(scenario, size, [*overrides, f"task.period={view.seconds!r}"])  # type: ignore[arg-type]
