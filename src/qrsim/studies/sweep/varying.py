"""What varies in a study: the schema of a parameter, and conditions, which set several values under one name."""

from __future__ import annotations

import json
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from qrsim.files import Content
from qrsim.scenarios.component_schema import Finite
from qrsim.scenarios.schema import NAME

# What a store and its tables can hold.
MOST_VALUES = 100_000


class Condition(str):
    """The name of a condition, with the values of the scenario that it sets.

    Attributes:
        settings: values by path.
    """

    settings: dict[str, object]

    def __new__(cls, name: str, settings: dict[str, object]) -> Condition:
        """Return the name of a condition as a string with its settings."""
        made = super().__new__(cls, name)
        made.settings = settings
        return made

    def __getnewargs__(self) -> tuple[str, dict[str, object]]:  # type: ignore[override]
        """Return the arguments from which a copy is made."""
        return str(self), self.settings


class Part(BaseModel):
    """Base of every part of a study: unknown keys are refused, nothing is coerced."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class VarySpec(Part):
    """Values of a parameter: a list, conditions by name, a number of steps between two ends, or a sampled range."""

    values: list[Any] | None = Field(
        None, description="the values, numbers or whatever may stand there", min_length=1, max_length=MOST_VALUES
    )
    conditions: dict[str, Content] | None = Field(
        None, description="in place of values: names, each with the values that it sets, by path", min_length=1
    )
    low: Finite | None = Field(None, description="smallest value")
    high: Finite | None = Field(None, description="largest value")
    count: int | None = Field(
        None, description="values from low to high; without it the sampling chooses", ge=2, le=MOST_VALUES
    )
    scale: Literal["linear", "log", "normal"] = Field(
        "linear",
        description="how values lie between low and high; normal: sampled around the middle, both ends three standard "
        "deviations away",
    )
    name: str | None = Field(None, description="label; default: its path", pattern=NAME, max_length=100)
    unit: str | None = Field(None, description="its unit, for tables and pictures; default: that of the scenario")

    @model_validator(mode="after")
    def _one_way(self) -> VarySpec:
        """Refuse values given in several ways, and bounds or a scale that cannot be combined."""
        ends = self.low is not None or self.high is not None or self.count is not None
        if (self.values is not None) + (self.conditions is not None) + ends != 1:
            raise ValueError("give either values, or conditions, or low and high")
        if ends and (self.low is None or self.high is None):
            raise ValueError("give both low and high")
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise ValueError(f"low, {self.low:g}, is not below high, {self.high:g}")
        if self.scale == "log" and (self.low is None or self.low <= 0.0):
            raise ValueError("a logarithmic scale needs low and high above 0")
        if self.scale == "normal" and self.count is not None:
            raise ValueError("the scale normal is for samples; leave out count")
        if self.values is not None and len({json.dumps(value) for value in self.values}) < len(self.values):
            raise ValueError("a value is given twice")
        return self

    @property
    def listed(self) -> list[object] | None:
        """Values of the parameter as a list, of conditions as ``Condition``; None for a range."""
        if self.conditions is None:
            return self.values
        return [Condition(name, settings) for name, settings in self.conditions.items()]


def assignment(path: str, value: object) -> str:
    """Return the argument PATH=VALUE of ``--set`` that sets a value in a scenario."""
    return f"{path}={json.dumps(value)}"
