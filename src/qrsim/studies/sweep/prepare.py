"""From a study to its plan: every value and every structure is checked before anything is flown."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations, product

from qrsim.errors import ScenarioError, UsageError, warn_user
from qrsim.files import Content
from qrsim.studies.sweep.axes import COUNT, Axis, apply, axes_of
from qrsim.studies.sweep.groups import Group, faults, make_group, same_structure, scenario_at
from qrsim.studies.sweep.plan import Plan, choices
from qrsim.studies.sweep.study import BASELINE, Study
from qrsim.studies.sweep.varying import Condition

MOST_LISTED = 5
SPEED, GUST = "world.wind.speed", "world.wind.gust"
# Beyond this number of corners they are taken two parameters at a time.
MOST_CORNERS = 64
# Of more values than these not each is tried: first so many parts of them, to find one that is allowed.
MOST_TRIED, TRIED = 100, 8


def plan_of(study: Study) -> Plan:
    """Check the paths and values that a study varies; return the plan of its runs and of their compiled programs.

    Raises:
        ScenarioError: paths are unknown or values are not allowed; the message lists them.
        UsageError: a parameter that changes the structure has a range.
    """
    axes = axes_of(study.spec)
    _refuse_unknown(study, axes)
    if all(axis.path != "time_step" for axis in axes):
        axes = axes_of(study.spec, scenario_at(study.content, {}).spec.time_step)
    _refuse_outside(study, axes)
    _warn_of_fixed_gust(study, axes)
    structural = tuple(axis for axis in axes if _is_structural(study, axis, axes))
    for axis in structural:
        if axis.values is None:
            raise UsageError(
                f"{study.spec.name}: vary.{axis.path}: it changes what is compiled, so it cannot be sampled; give "
                "values"
            )
    paths = tuple(axis.path for axis in structural)
    groups = _groups(study, structural, tuple(axis for axis in axes if axis.path not in paths))
    plan = Plan(study, axes, paths, groups)
    if plan.listed:
        _refuse_listed(plan)
    return plan


def plan_of_numbers(study: Study) -> Plan:
    """Plan a study of numeric parameters with ranges known to be valid, without the checks.

    ``plan_of`` tries every pair of parameters at their ends, which takes minutes for dozens of them. Here only the
    points with all lowest and all highest values are checked.

    Raises:
        ScenarioError: one of the two points is not allowed.
    """
    axes = axes_of(study.spec, scenario_at(study.content, {}).spec.time_step)
    for corner in ({axis.path: axis.ends()[end] for axis in axes} for end in (0, 1)):
        if wrong := faults(study.content, corner):
            raise ScenarioError(study.spec.name, wrong)
    return Plan(study, axes, (), {(): make_group(study.content, {}, axes, study.spec.precision)})


def plan_of_conditions(study: Study) -> Plan:
    """Plan a study of one parameter with conditions known to be valid, without the checks.

    ``plan_of`` loads the scenario of each condition several times, here once.

    Raises:
        ScenarioError: a condition is not allowed.
    """
    (axis,) = axes_of(study.spec)
    values = enumerate(axis.values or ())
    groups: dict[tuple[int, ...], Group] = {
        (i,): make_group(study.content, {axis.path: value}, (), study.spec.precision) for i, value in values
    }
    return Plan(study, (axis,), (axis.path,), groups)


def _warn_of_fixed_gust(study: Study, axes: tuple[Axis, ...]) -> None:
    """Warn of a forecast with a varied mean speed and a fixed gust, so that their sum does not vary."""
    varied = {axis.path for axis in axes}
    for axis in axes:
        for value in axis.values or ():
            varied |= set(value.settings) if isinstance(value, Condition) else set()
    wind = study.content.get("world", {}).get("wind")
    gust = wind.get("gust") if isinstance(wind, dict) else None
    if SPEED in varied and GUST not in varied and gust is not None:
        warn_user(
            f"{study.spec.name}: vary.{SPEED}: the gust stays at {gust:g} m/s, so turbulence falls where the speed "
            f"rises; {GUST}_factor in place of the gust is a multiple of the speed"
        )


def _first(axes: Sequence[Axis]) -> Content:
    """Return path -> first value, of each axis."""
    return {axis.path: axis.values[0] if axis.values else axis.low for axis in axes}


def _refuse_unknown(study: Study, axes: tuple[Axis, ...]) -> None:
    """Raise an error if the scenario itself is wrong, or lacks a path that the study varies."""
    name = study.spec.name
    own = faults(study.content, {})
    if own:
        raise ScenarioError(name, own)
    found = []
    for axis in axes:
        # Another parameter may have to be set first, as a wind before its speed.
        wrong = [faults(study.content, at) for at in _settings(axis, axes)]
        if all(wrong):
            missing = [line for line in wrong[0] if "no such" in line or "no fleet" in line or "no sensor" in line]
            missing += [line for line in wrong[0] if "has no parts" in line or "an index from" in line]
            found += [f"vary.{axis.path}: {line}" for line in missing]
    if found:
        raise ScenarioError(name, list(dict.fromkeys(found)))


def _settings(axis: Axis, axes: Sequence[Axis]) -> Iterator[Content]:
    """Yield two points to test an axis at: its first value alone, and with the first values of all axes."""
    value = _first([axis])
    yield value
    yield {**_first(axes), **value}


def _refuse_outside(study: Study, axes: tuple[Axis, ...]) -> None:
    """Raise an error for axis values that the scenario does not allow, before anything is flown."""
    lines, judged = [], []
    for axis in axes:
        bad = _bad_values(study.content, axis, _surroundings(axis, axes))
        judged.append((axis, bad))
        lines += [f"vary.{axis.path}: {line}" for line in _described(axis, bad)]
    if lines:
        raise ScenarioError(f"{study.spec.name}: {_count_bad(study, judged)}", lines)


def _surroundings(axis: Axis, axes: Sequence[Axis]) -> list[Content]:
    """Return values of the other axes to test an axis with; a value is allowed if it works with one of them."""
    others = [other for other in axes if other is not axis]
    lasts = {other.path: other.values[-1] if other.values else other.high for other in others}
    return [_first(others), lasts, {}]


def _bad_values(content: Content, axis: Axis, others: Sequence[Mapping[str, object]]) -> dict[object, str]:
    """Return value -> error for the values of an axis that are not allowed; of a range only its ends."""

    def wrong(value: object) -> str:
        """Return the errors of a value with each setting of the other axes; "" if it works with one."""
        found = ""
        for other in others:
            found = "; ".join(faults(content, {**other, axis.path: value}))
            if not found:
                break
        return found

    if not axis.numeric:
        return {_key(value): text for value in axis.values or () if (text := wrong(value))}
    ordered = [axis.low, axis.high] if axis.values is None else sorted(axis.values)
    # What is allowed is an interval, so that values between two good ones need no look.
    low, high = wrong(ordered[0]), wrong(ordered[-1])
    if not low and not high:
        return {}
    if axis.values is None:
        return {value: text for value, text in zip(ordered, (low, high), strict=True) if text}
    if len(ordered) > MOST_TRIED:
        return _by_halving(ordered, wrong)
    return {value: text for value in ordered if (text := wrong(value))}


def _by_halving(ordered: Sequence[object], wrong: Callable[[object], str]) -> dict[object, str]:
    """Return value -> error for many sorted values, found by bisection between allowed and wrong ones."""
    tried = [round(part * (len(ordered) - 1) / TRIED) for part in range(TRIED + 1)]
    good = next((i for i in tried if not wrong(ordered[i])), None)
    if good is None:
        return dict.fromkeys(ordered, wrong(ordered[0]))
    bad: dict[object, str] = {}
    for side in (ordered[: good + 1], ordered[: good - 1 if good else None : -1]):
        first, last = -1, len(side) - 1
        while last - first > 1:
            middle = (first + last) // 2
            first, last = (middle, last) if wrong(side[middle]) else (first, middle)
        if last > 0:
            bad |= dict.fromkeys(side[:last], wrong(side[0]))
    return bad


def _key(value: object) -> str | int | float:
    """Return a value as a key for a dict: itself, or its text if it is not hashable."""
    return value if isinstance(value, str | int | float | bool) else repr(value)


def _described(axis: Axis, bad: Mapping[object, str]) -> list[str]:
    """Return a line of text for each of the first few bad values of an axis."""
    total = len(axis.values or ())
    lines = [f"{value!r}: {text}" for value, text in list(bad.items())[:MOST_LISTED]]
    if len(bad) > MOST_LISTED:
        lines.append(f"... and {len(bad) - MOST_LISTED} more of its {total} values")
    return lines


def _count_bad(study: Study, judged: Sequence[tuple[Axis, Mapping[object, str]]]) -> str:
    """Return the text that says how many points have a value that is not allowed; ``judged``: (axis, bad values)."""
    crossed = [(axis, bad) for axis, bad in judged if axis.values is not None]
    sampling = study.spec.sampling
    if len(crossed) < len(judged) or (sampling is not None and sampling.type == "list"):
        return "values that are not allowed, nothing was flown"
    points = math.prod(len(axis.values or ()) for axis, _ in crossed)
    fine = math.prod(len(axis.values or ()) - len(bad) for axis, bad in crossed)
    return f"{points - fine} of {points} points have values that are not allowed, nothing was flown"


def _is_structural(study: Study, axis: Axis, axes: Sequence[Axis]) -> bool:
    """Return whether an axis changes what is compiled, or has a single value only."""
    if not axis.numeric or axis.path.endswith(COUNT):
        return True
    low, high = axis.ends()
    if low == high:
        return True
    for others in _surroundings(axis, axes):
        points = [{**others, axis.path: value} for value in (low, high)]
        if not any(faults(study.content, point) for point in points):
            one, other = (scenario_at(study.content, point) for point in points)
            return not same_structure(one, other, study.spec.precision)
    return False


def _groups(study: Study, structural: tuple[Axis, ...], numbers: tuple[Axis, ...]) -> dict[tuple[int, ...], Group]:
    """Return indices of structural values -> group of worlds; raise ScenarioError for combinations that fail."""
    listed = study.spec.sampling is not None and study.spec.sampling.type == "list"
    wrong: list[str] = []
    groups = {}
    for i, (key, chosen) in enumerate(choices(structural, listed)):
        content = study.content
        for corner in _corners(numbers, every=i == 0) if not listed else ():
            found = faults(content, {**chosen, **corner})
            wrong += [f"{_point({**chosen, **corner})}: {line}" for line in found]
        if not wrong:
            groups[key] = _group(study, chosen, numbers)
    if wrong:
        more = [f"... and {len(wrong) - MOST_LISTED} more"] if len(wrong) > MOST_LISTED else []
        raise ScenarioError(
            f"{study.spec.name}: values that do not go together, nothing was flown", wrong[:MOST_LISTED] + more
        )
    return groups


def _group(study: Study, chosen: Mapping[str, object], numbers: tuple[Axis, ...]) -> Group:
    """Return the group of worlds for a combination of structural values: its World, and places of varied numbers."""
    if study.spec.policy != BASELINE:
        return make_group(study.content, chosen, numbers, study.spec.precision)
    # Flown one by one from its scenario.
    content = copy.deepcopy(study.content)
    for path, value in chosen.items():
        apply(content, path, value)
    scenario = scenario_at(content, _first(numbers))
    paths = tuple(axis.path for axis in numbers)
    world = scenario.world(study.spec.precision)
    return Group(content, world, scenario.ticks, scenario.spec.time_step, None, paths)


def _point(values: Mapping[str, object]) -> str:
    """Return path and value of each parameter of a point as text."""
    return ", ".join(f"{path} = {value!r}" for path, value in values.items())


def _corners(axes: tuple[Axis, ...], every: bool) -> Iterator[Content]:
    """Yield points at the ends of axes: all (of many axes by pairs) with ``every``, else the lowest and the highest."""
    if not axes:
        yield {}
        return
    ends = {axis.path: axis.ends() for axis in axes}
    lowest, highest = ({path: pair[i] for path, pair in ends.items()} for i in (0, 1))
    if not every:
        yield from (lowest, highest)
    elif 2 ** len(axes) <= MOST_CORNERS:
        for chosen in product(*ends.values()):
            yield dict(zip(ends, chosen, strict=True))
    else:
        yield highest
        for one, other in combinations(axes, 2):
            for values in product(ends[one.path], ends[other.path]):
                yield {**lowest, one.path: values[0], other.path: values[1]}


def _refuse_listed(plan: Plan) -> None:
    """Check each point of a study that lists its points; raise an error for the wrong ones."""
    wrong = []
    for point in range(plan.shape[0]):
        values = plan.values_at((point, 0))
        wrong += [f"point {point}, {_point(values)}: {line}" for line in faults(plan.study.content, values)]
    if wrong:
        more = [f"... and {len(wrong) - MOST_LISTED} more"] if len(wrong) > MOST_LISTED else []
        raise ScenarioError(f"{plan.study.spec.name}: nothing was flown", wrong[:MOST_LISTED] + more)
