"""A study file: schema, source and digest."""

from __future__ import annotations

import copy
import hashlib
import inspect
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from qrsim.errors import ScenarioError, UsageError, did_you_mean
from qrsim.files import Content
from qrsim.files.user_files import read_text
from qrsim.files.yaml_text import parse_yaml
from qrsim.interface.policies import load_function, sources_by_team
from qrsim.scenarios.component_schema import Finite
from qrsim.scenarios.problems import describe
from qrsim.scenarios.providing import anchor_code
from qrsim.scenarios.reading import anchor_files, apply_override, read_scenario
from qrsim.scenarios.registry import made
from qrsim.scenarios.schema import NAME
from qrsim.studies.sweep.metrics import METRICS, Metric
from qrsim.studies.sweep.own_metrics import own_metrics
from qrsim.studies.sweep.varying import Part, VarySpec, assignment

BASELINE = "baseline"
# What a study calls the metrics of a user's own.
OWN = "own_metrics"
# What a store and its tables can hold.
MOST_POINTS, MOST_EPISODES = 2**20, 10**8


class SamplingSpec(Part):
    """Joint sampling of the parameters that have a range."""

    type: Literal["list", "latin_hypercube", "sobol", "saltelli"] = Field(
        description="list: the values of all parameters one by one; saltelli: a sample for Sobol indices"
    )
    points: int | None = Field(
        None, description="number of points; of saltelli, of the base sample", ge=1, le=MOST_POINTS
    )
    seed: int = Field(0, description="seed of the sample", ge=0)
    paired: bool = Field(False, description="give point i the seed first_seed + i")

    @model_validator(mode="after")
    def _points(self) -> SamplingSpec:
        """Refuse a number of points that the type of sampling cannot have."""
        if (self.type == "list") == (self.points is not None):
            raise ValueError("points: missing" if self.points is None else "a list has as many points as values")
        if self.paired and self.type == "list":
            raise ValueError("paired: a list is flown with all seeds")
        if self.type == "saltelli" and self.points is not None and self.points & (self.points - 1):
            raise ValueError(f"points: {self.points} is not a power of 2")
        return self


class FailureSpec(Part):
    """When an episode counts as failed."""

    metric: str = Field("stopped", description="a metric of the study")
    above: Finite | None = Field(None, description="it failed where the metric is above this")
    below: Finite | None = Field(None, description="it failed where the metric is below this")

    @model_validator(mode="after")
    def _one_limit(self) -> FailureSpec:
        """Refuse a definition of failure that has neither a limit above nor one below, or has both."""
        if (self.above is None) == (self.below is None):
            raise ValueError("give either above or below")
        return self


def _in_one_line(policy: object) -> object:
    """Return policies given by team as one text "TEAM=POLICY,..."; other values unchanged."""
    if isinstance(policy, dict) and all(isinstance(part, str) for pair in policy.items() for part in pair):
        return ",".join(f"{team}={source}" for team, source in policy.items())
    return policy


class StudySpec(Part):
    """A study: a scenario, a policy, the varied parameters, and the metrics to keep."""

    name: str = Field(description="short name, used for stores", pattern=NAME, max_length=100)
    description: str = Field("", description="one or two sentences")
    scenario: str | Content = Field(description="a built-in name, a .yaml file, or the content of one")
    set: Content = Field({}, description="values of the scenario for the whole study, by path")
    policy: Annotated[str | None, BeforeValidator(_in_one_line)] = Field(
        None,
        description="MODULE:NAME or FILE.py:NAME, one for each fleet or vehicle by name, or 'baseline', the task's",
    )
    estimator: str | None = Field(None, description="MODULE:NAME or FILE.py:NAME, in place of the sensors")
    policy_ticks: int = Field(1, description="the policy is asked at every so-many-th tick", ge=1)
    vary: dict[str, VarySpec] = Field(description="parameters by path", min_length=1)
    sampling: SamplingSpec | None = Field(None, description="how the parameters with a range are sampled")
    seeds: int = Field(description="episodes at each point", ge=1, le=10**7)
    first_seed: int = Field(0, description="seed of the first one; the others follow", ge=0, lt=2**62)
    metrics: list[str] = Field(description="metrics that are kept of each episode", min_length=1)
    own_metrics: str | None = Field(
        None, description="metrics of your own, FILE.py:NAME or MODULE:NAME; 'metrics' names their numbers"
    )
    failure: FailureSpec = Field(FailureSpec.model_validate({"above": 0.0}), description="when an episode failed")
    track: float | None = Field(
        None, description="keep position and charge of every vehicle at this interval [s]; default: not", gt=0.0
    )
    precision: Literal["float32", "float64"] = Field("float32", description="arithmetic")
    batch: int | None = Field(None, description="episodes of a batch, about; default: a second of work", ge=1)

    @model_validator(mode="after")
    def _together(self) -> StudySpec:
        """Refuse metrics, policies, tracks and samplings that cannot be combined."""
        for name in [*self.metrics, self.failure.metric]:
            # Which names a user's own metrics have is known when their file is read.
            if name not in METRICS and not self.own_metrics:
                raise ValueError(f"metrics: no metric is called '{name}'{did_you_mean(name, METRICS)}")
            if name in METRICS and METRICS[name].task and self.policy != BASELINE:
                raise ValueError(f"metrics: '{name}' is of a task that 'policy: {BASELINE}' flies")
        if self.policy == BASELINE and (self.estimator or self.policy_ticks != 1):
            raise ValueError(f"policy: '{BASELINE}' has no estimator and no policy_ticks")
        if self.policy == BASELINE and self.own_metrics:
            raise ValueError(f"own_metrics: 'policy: {BASELINE}' has its own; give a policy of another kind, or none")
        if self.track is not None and self.policy == BASELINE:
            raise ValueError(f"track: not with 'policy: {BASELINE}'")
        if self.sampling is not None and self.sampling.paired and self.seeds != 1:
            raise ValueError("seeds: paired points have one seed each; give seeds: 1")
        ranges = [path for path, item in self.vary.items() if item.listed is None and item.count is None]
        kind = self.sampling.type if self.sampling else None
        if kind == "list":
            lengths = {len(item.listed or ()) for item in self.vary.values()}
            if len(lengths) != 1 or 0 in lengths:
                raise ValueError("sampling: a list needs values for every parameter, as many for each")
        elif bool(kind) != bool(ranges):
            raise ValueError(
                f"sampling: missing; {ranges[0]} has a range" if ranges else "sampling: no parameter has a range"
            )
        episodes = self.seeds * (self.sampling.points or 1 if self.sampling else 1)
        for item in self.vary.values() if kind != "list" else ():
            episodes *= item.count or len(item.listed or (0,))
        if episodes > MOST_EPISODES:
            raise ValueError(f"{episodes:.3g} episodes; allowed: at most {MOST_EPISODES:.3g}")
        names = [item.name or path for path, item in self.vary.items()]
        taken = {"seed", "point", "flown", "track", *METRICS}
        for name in names:
            if names.count(name) > 1 or name in taken:
                raise ValueError(f"vary: the name '{name}' is taken; give another")
        return self


@dataclass(frozen=True)
class Study:
    """A checked study.

    Attributes:
        spec: as it is written, with what the command line changed.
        content: of the scenario, with what is set at all points.
        source: the scenario as ``qrsim run`` takes it, a name or a path; None where its content is in the study.
        code: digests of the files of policy, estimator and own metrics.
        own_metrics: a user's metrics by name.
    """

    spec: StudySpec
    content: Content
    source: str | None
    code: dict[str, str]
    own_metrics: dict[str, Metric] = field(default_factory=dict)

    def metric(self, name: str) -> Metric:
        """Return a metric of the study by name: the user's, else the built-in one."""
        return self.own_metrics[name] if name in self.own_metrics else METRICS[name]

    @property
    def settings(self) -> Content:
        """All settings that the results depend on; two studies with equal settings are the same study."""
        spec = self.spec.model_dump(mode="json", exclude={"description", "failure", "scenario", "set"})
        # A default that is filled in later changes nothing.
        spec["metrics"] = sorted({*self.spec.metrics, self.spec.failure.metric})
        if spec["own_metrics"] is None:
            spec.pop("own_metrics")
        if spec["track"] is None:
            spec.pop("track")
        if spec["sampling"] is not None and not spec["sampling"]["paired"]:
            spec["sampling"].pop("paired")
        for item in spec["vary"].values():
            item.pop("unit")
            if item["conditions"] is None:
                item.pop("conditions")
        return {**spec, "scenario": self.content, "code": self.code}

    @property
    def digest(self) -> str:
        """Digest of the study's settings, in hexadecimal."""
        text = json.dumps(self.settings, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()


def built_in_studies() -> list[str]:
    """Return the names of the studies that come with qrsim."""
    folder = resources.files("qrsim.studies.sweep")
    return sorted(item.name.removesuffix(".yaml") for item in folder.iterdir() if item.name.endswith(".yaml"))


def load_study(source: str, changes: Content | None = None, overrides: Iterable[str] = (), values: int = 0) -> Study:
    """Read and check a study by name or path; ``values`` limits how many values of each parameter are used.

    Args:
        source: a built-in name or the path of a YAML file.
        changes: what is said in place of the file, by name: seeds, batch, points.
        overrides: assignments to the scenario at all points, such as "duration=10".
        values: at most so many of each parameter that has values, evenly chosen; 0: all.

    Raises:
        UsageError: there is no such study or scenario.
        ScenarioError: it is wrong; the message lists the faults.
    """
    text, folder = _read(source)
    content = parse_yaml(text, source)
    if not isinstance(content, dict):
        raise ScenarioError(source, ["expected keys and values such as name: my_study"])
    if "scenario" not in content and {"fleets", "extends"} & content.keys():
        raise ScenarioError(source, ["is a scenario and no study; a study has scenario: FILE, vary, seeds and metrics"])
    content = _changed(content, changes or {}, values)
    try:
        spec = StudySpec.model_validate(content)
    except ValidationError as error:
        raise ScenarioError(source, [_mine(line) for line in describe(error, StudySpec, content)]) from None
    given = spec.scenario
    if isinstance(given, str) and given.endswith((".yaml", ".yml")):
        given = str(folder / os.path.expanduser(given))
    _, scenario = read_scenario(given)
    scenario = copy.deepcopy(scenario)
    if isinstance(given, dict):
        scenario.setdefault("name", spec.name)
    for path, value in spec.set.items():
        apply_override(scenario, assignment(path, value))
    spec = spec.model_copy(update={"set": {**spec.set, **_as_mapping(overrides)}})
    for override in overrides:
        apply_override(scenario, override)
    anchor_files(scenario, folder)
    anchor_code(scenario, folder)
    code = {what: _code(what, name, folder) for what in ("policy", "estimator", OWN) if (name := getattr(spec, what))}
    updates = {what: named for what, (named, _) in code.items()}
    return Study(
        spec.model_copy(update=updates),
        scenario,
        given if isinstance(given, str) else None,
        {what: digest for what, (_, digest) in code.items()},
        _own_metrics(spec, code[OWN][0]) if OWN in code else {},
    )


def _as_mapping(overrides: Iterable[str]) -> Content:
    """Convert overrides PATH=VALUE to a mapping of path to value."""
    pairs = (override.partition("=") for override in overrides)
    return {path.strip(): parse_yaml(text, f"--set {path}") for path, _, text in pairs}


def _mine(line: str) -> str:
    """Return an error text without the prefix "scenario: "."""
    return line if line.startswith("scenario: missing") else line.removeprefix("scenario: ")


def _read(source: str) -> tuple[str, Path]:
    """Read the YAML text of a study, and return it with the folder that its paths start in."""
    known = built_in_studies()
    if source in known:
        return resources.files("qrsim.studies.sweep").joinpath(f"{source}.yaml").read_text("utf-8"), Path.cwd()
    path = Path(source)
    if path.suffix not in (".yaml", ".yml"):
        raise UsageError(f"no study is called '{source}'{did_you_mean(source, known)} (or give a .yaml file)")
    try:
        return read_text(path), path.parent.absolute()
    except FileNotFoundError:
        near = [str(item) for item in path.parent.glob("*.y*ml")] if path.parent.is_dir() else []
        hint = did_you_mean(source, [*near, *known])
        raise UsageError(f"study {path}: no such file{hint if 'mean' in hint else ''}") from None
    except OSError as error:
        raise UsageError(f"study {path}: cannot be read: {error.strerror}") from None


def _changed(content: Content, changes: Content, values: int) -> Content:
    """Return a study's content with changes of the command line applied; ``values``: most values per parameter."""
    content = copy.deepcopy(content)
    sampling = content.get("sampling")
    for name, value in changes.items():
        if name != "points":
            content[name] = value
        elif isinstance(sampling, dict) and sampling.get("type") != "list":
            sampling["points"] = value
        else:
            raise UsageError(f"--points {value}: this study samples no parameter; see --values")
    varied = content.get("vary")
    for item in varied.values() if values and isinstance(varied, dict) else ():
        if isinstance(item, dict) and isinstance(item.get("values"), list):
            item["values"] = _thinned(item["values"], values)
        elif isinstance(item, dict) and isinstance(item.get("conditions"), dict):
            item["conditions"] = dict(_thinned(list(item["conditions"].items()), values))
        elif isinstance(item, dict) and isinstance(item.get("count"), int):
            item["count"] = max(2, min(values, item["count"]))
    return content


def _thinned(values: list[object], most: int) -> list[Any]:
    """Return at most ``most`` evenly spaced ones of some values, with the first and the last."""
    if most >= len(values) or most < 2:
        return values[: max(1, most)] if most < 2 else values
    return [values[round(i * (len(values) - 1) / (most - 1))] for i in range(most)]


def _own_metrics(spec: StudySpec, source: str) -> dict[str, Metric]:
    """Load a study's metrics object by a user; raise UsageError if the study names metrics that do not exist."""
    _, own = own_metrics(source)
    for name in [*spec.metrics, spec.failure.metric]:
        if name not in METRICS and name not in own:
            raise UsageError(f"metrics: no metric is called '{name}'{did_you_mean(name, [*own, *METRICS])}")
    return own


def _code(what: str, name: str, folder: Path) -> tuple[str, str]:
    """Return a user function's name FILE:FUNCTION with an absolute path, and a digest of the file."""
    if what == "policy" and name == BASELINE:
        return name, ""
    teams = sources_by_team(name) if what == "policy" else None
    if teams is None:
        name = _from_anywhere(name, folder)
    else:
        name = ",".join(f"{team}={_from_anywhere(source, folder)}" for team, source in teams.items())
    return name, digest_of(what, name)


def _from_anywhere(name: str, folder: Path) -> str:
    """Return FILE.py:FUNCTION with an absolute path, a relative one starting in ``folder``; other names unchanged."""
    place, _, function = name.rpartition(":")
    if place.endswith(".py"):
        return f"{(folder / os.path.expanduser(place)).absolute()}:{function}"
    return name


def digest_of(what: str, name: str) -> str:
    """Return a digest of the file that defines a user's function; "" if no file does.

    Raises:
        UsageError: there is no such function.
    """
    teams = sources_by_team(name) if what == "policy" else None
    if teams is not None:
        return ",".join(digest_of(what, source) for source in teams.values())
    found: Any = made("metric", name) if what == OWN else load_function(what, name)
    place = name.rpartition(":")[0]
    if not place.endswith(".py"):
        itself = inspect.isroutine(found) or inspect.isclass(found)
        place = inspect.getsourcefile(found if itself else type(found)) or ""
    return hashlib.sha256(Path(place).read_bytes()).hexdigest() if place else ""
