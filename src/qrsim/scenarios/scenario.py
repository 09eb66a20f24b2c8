"""Loading a scenario: reading, overriding, checking, building."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ValidationError

from qrsim.core.tables import Table, Tabled, number_text
from qrsim.errors import ScenarioError, warn_user
from qrsim.files import Content
from qrsim.files.yaml_text import dump_yaml
from qrsim.models.sensors.earth_field import earth_field_ned
from qrsim.models.site import Site
from qrsim.scenarios import build
from qrsim.scenarios.buildings import with_buildings
from qrsim.scenarios.cross_checks import problems
from qrsim.scenarios.forecast import insert_forecast
from qrsim.scenarios.places import in_ned
from qrsim.scenarios.plan_lines import PlannedVehicle
from qrsim.scenarios.plausibility import plausibility_warnings
from qrsim.scenarios.problems import describe
from qrsim.scenarios.providing import anchor_code, outside_components, provide_components
from qrsim.scenarios.reading import (
    anchor_files,
    apply_override,
    built_in_names,
    check_size,
    checked_overrides,
    read_scenario,
)
from qrsim.scenarios.schema import ScenarioSpec, json_schema
from qrsim.scenarios.sensor_sets import insert_sensor_sets
from qrsim.scenarios.trial import trial_problems
from qrsim.scenarios.vehicle_file import insert_vehicle_files
from qrsim.scenarios.vehicle_models import insert_vehicle_models
from qrsim.scenarios.weather import with_profile
from qrsim.world.state import World

__all__ = ["Scenario", "built_in_names", "json_schema", "load_scenario"]


@dataclass(frozen=True)
class Scenario(Tabled):
    """A checked scenario.

    Attributes:
        spec: its content, every default filled in, all places in NED.
        planned: the plans that its vehicles came from, for messages; nothing else depends on them.
    """

    spec: ScenarioSpec
    planned: tuple[PlannedVehicle, ...] = field(default=(), compare=False, repr=False)
    __repr__ = Tabled.__repr__

    def _table(self) -> Table:
        """Return the table of the scenario's parts, types and parameters that printing and notebooks show."""
        spec, parts = self.spec, []
        for name in type(spec.world).model_fields:
            parts.append((f"world.{name}", getattr(spec.world, name)))
        for title, fleet in spec.fleets.items():
            parts += [(f"fleets.{title}.{name}", getattr(fleet, name)) for name in _OF_FLEETS]
            parts += [(f"fleets.{title}.sensors.{name}", sensor) for name, sensor in fleet.sensors.items()]
        parts.append(("task", spec.task))
        typed = [(path, part) for path, part in parts if isinstance(part, BaseModel) and "type" in vars(part)]
        rows = [(path, vars(part)["type"], _given(part)) for path, part in typed if vars(part)["type"] != "none"]
        fleets = ", ".join(f"{len(fleet.vehicles)} of '{name}'" for name, fleet in spec.fleets.items())
        title = f"scenario '{self.name}' of {self.duration:g} s in steps of {spec.time_step:g} s: {fleets}"
        return Table(title, ("part", "type", "parameters"), rows)

    @property
    def name(self) -> str:
        """Short name of the scenario, such as "hover"."""
        return self.spec.name

    @property
    def duration(self) -> float:
        """Simulated duration of a run [s]."""
        return self.spec.duration

    @property
    def ticks(self) -> int:
        """Number of simulation steps of a run."""
        return round(self.spec.duration / self.spec.time_step)

    @property
    def steps(self) -> int:
        """Number of decision steps of the scenario's task; 0 without a task."""
        return round(self.spec.duration / self.spec.task.period) if self.spec.task.type != "none" else 0

    @property
    def site(self) -> Site:
        """Site of the scenario: the geodetic origin of the local frame."""
        return self.spec.site.at()

    @property
    def earth_field_ned(self) -> npt.NDArray[np.float64]:
        """Earth's magnetic field (3,) in NED [uT] at the site and start time, which magnetometers measure.

        Raises:
            UsageError: the start is outside the years of the World Magnetic Model.
        """
        return earth_field_ned(self.site, self.spec.start_time)

    @property
    def outside(self) -> list[dict[str, str]]:
        """Components that are not built in: a dict for each with path, kind, type, class, file, its sha256, origin."""
        return outside_components(self.spec.model_dump(mode="json"))

    def world(self, precision: str = "float32") -> World:
        """Build the scenario's World, with numbers as arrays of ``precision`` (float32 or float64)."""
        return build.build_world(self.spec, precision)

    def task(self, precision: str = "float32") -> Any:
        """Build the scenario's task, with numbers as arrays of ``precision``; ``NoTask`` if it has none."""
        return build.build_task(self.spec, precision)

    def __reduce__(self) -> tuple[object, ...]:
        # By its content, because the classes of its parts are made while the package is imported and have no names.
        return _of_content, (self.spec.model_dump(),)

    def to_yaml(self) -> str:
        """Return the scenario as YAML, every default written out; loading it gives the same scenario."""
        return dump_yaml(self.spec.model_dump(mode="json"))


# Parts of a fleet that a table shows, besides its sensors.
_OF_FLEETS = ("vehicle", "controller", "guidance", "battery")


def _given(part: BaseModel) -> str:
    """Return the scalar parameters of a part of a scenario as text, with units."""
    texts = []
    for name, info in type(part).model_fields.items():
        value = getattr(part, name)
        if name != "type" and isinstance(value, str | bool | int | float):
            extra = info.json_schema_extra
            unit = extra.get("unit", "") if isinstance(extra, dict) else ""
            texts.append(f"{name} {number_text(value)}{f' {unit}' if unit not in ('', '1') else ''}")
    return ", ".join(texts)


def _of_content(content: Mapping[str, object]) -> Scenario:
    """Build a scenario from its content in another process, to unpickle it there."""
    # Another process has yet to load the components from outside.
    provide_components(content, "scenario")
    return Scenario(ScenarioSpec.model_validate(content))


def load_scenario(
    source: str | Path | Content,
    overrides: Iterable[str] = (),
    *,
    quiet: bool = False,
    local: bool = True,
    named_code: bool = True,
) -> Scenario:
    """Read and check a scenario by name, path or content; warn of implausible values, raise ScenarioError for errors.

    Args:
        source: a built-in name, the path of a YAML file, or the content as a dict.
        overrides: assignments such as "world.wind.speed_20ft=7", applied before the check.
        quiet: whether to leave out the warnings, where somebody has had them or many variants are tried.
        local: whether the user of this machine wrote it; only then is code loaded that it names.
        named_code: False loads components of installed packages, but no file and no module that it names.

    Raises:
        UsageError: there is no such scenario.
        ScenarioError: its content is wrong; the message lists every fault.
    """
    overrides = checked_overrides(overrides)
    if isinstance(source, dict):
        check_size(source, "scenario")
    name, content = read_scenario(source)
    content = copy.deepcopy(content)
    for assignment in overrides:
        apply_override(content, assignment)
    check_size(content, name)
    # Files named in Python or by an override are relative to the working folder.
    anchor_files(content, Path.cwd())
    anchor_code(content, Path.cwd())
    insert_vehicle_files(content, name)
    odd = insert_vehicle_models(content, name)
    insert_forecast(content, name)
    insert_sensor_sets(content, name)
    if local:
        provide_components(content, name, named_code)
    try:
        spec = ScenarioSpec.model_validate(content)
    except ValidationError as error:
        raise ScenarioError(name, describe(error, ScenarioSpec, content)) from None
    spec, found, written, planned = in_ned(spec)
    if not found:
        spec, found = with_buildings(spec, quiet)
    if not found:
        spec, found = with_profile(spec, quiet)
    spec = spec if found else build.on_ground(spec)
    found = found or [_as_written(problem, written) for problem in problems(spec)]
    found = found or list(build.weather_problems(spec)) or list(trial_problems(spec))
    if found:
        raise ScenarioError(name, found)
    for words in () if quiet else (*odd, *plausibility_warnings(spec)):
        warn_user(f"{spec.name}: {words}")
    return Scenario(spec, tuple(planned))


def _as_written(problem: str, written: dict[str, str]) -> str:
    """Return an error text with its path replaced by the one that the user wrote; ``written``: path -> path."""
    path, colon, rest = problem.partition(":")
    return f"{written.get(path, path)}{colon}{rest}"
