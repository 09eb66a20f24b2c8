"""The page of environments: Gymnasium, PettingZoo and JAX, with their spaces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from qrsim.envs import ANY_TASK, LEARNED, SEVERAL, SINGLE, Functional, gymnasium_id, learner_id
from qrsim.tasks.agents import Axis
from tools.reference.tables import code, number, page, table


def pages() -> Mapping[str, str]:
    """Return the page."""
    introduction = """Each task of qrsim that commands one vehicle is an environment of Gymnasium, made by
        `gymnasium.make(ID)`. A task that commands several is one of PettingZoo:
        `qrsim.envs.parallel_env(SCENARIO)`. All are pure functions of JAX as well:
        `qrsim.envs.Functional.of(SCENARIO)`. An episode is terminated when a vehicle stops, and truncated after its
        last step. [Design of the tasks](../explanation/task_design.md)
        defines the rewards, [baselines](../explanation/baselines.md) scores the baselines."""
    each = {name: Functional.of(name) for name in (*SINGLE, *SEVERAL)}
    rows = [_row(name, functional) for name, functional in each.items()]
    listed = table(("scenario", "ID", "agents", "observation", "action", "steps", "period [s]"), rows)
    other = (
        f'`gymnasium.make("{ANY_TASK}", scenario=SCENARIO)` takes any scenario with a task. An action is numbers'
        " in [-1, 1], which the task scales to the ranges below. "
        + ", ".join(code(learner_id(name)) for name in LEARNED)
        + " have the [form for learners](../howto/learn.md#a-form-for-learners)."
    )
    groups: dict[str, list[str]] = {}
    for name, functional in each.items():
        groups.setdefault(_spaces(functional), []).append(name)
    parts = [f"## {', '.join(names)}\n\n{text}" for text, names in groups.items()]
    return {"environments.md": page("Environments", introduction, listed, other, *parts)}


def _row(name: str, functional: Functional) -> tuple[str, ...]:
    task = functional.play.task
    made = gymnasium_id(name) if name in SINGLE else ""
    acts = functional.play.sides[0].axes
    return (
        code(name), code(made), str(len(functional.agents)), _count(functional.observation_axes), str(len(acts)),
        str(functional.play.steps), number(float(task.period)),
    )  # fmt: skip


def _count(axes: Any) -> str:
    return "dict" if isinstance(axes, Mapping) else str(len(axes))


def _spaces(functional: Functional) -> str:
    """Return the tables of an environment's observation and action."""
    sees: Any = functional.observation_axes
    seen = (
        {"Observation": sees}
        if not isinstance(sees, Mapping)
        else {f"Observation `{name}`": part for name, part in sees.items()}
    )
    tables = [f"{title}:\n\n{_axes(axes)}" for title, axes in seen.items() if not isinstance(axes, Mapping)]
    tables += [
        f"Action{f' of {code(side.fleet)}' if len(functional.play.sides) > 1 else ''}:\n\n{_axes(side.axes)}"
        for side in functional.play.sides
    ]
    return "\n\n".join(tables)


def _axes(axes: Iterable[Axis]) -> str:
    rows = [
        (
            code(axis.name),
            "" if axis.unit == "1" else axis.unit,
            *("" if abs(end) == float("inf") else number(float(end)) for end in (axis.low, axis.high)),
            "" if axis.neutral is None else number(float(axis.neutral)),
        )
        for axis in axes
    ]
    # Only some actions have a neutral value.
    titles = (
        ("number", "unit", "low", "high", "0 is") if any(row[-1] for row in rows) else ("number", "unit", "low", "high")
    )
    return table(titles, [row[: len(titles)] for row in rows])
