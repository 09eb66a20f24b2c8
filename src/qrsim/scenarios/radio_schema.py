"""What a scenario says of the radio between vehicles: its schema."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field, model_validator

from qrsim.models.radio.network import Network
from qrsim.models.radio.parameters import PRESETS
from qrsim.scenarios.component_schema import Finite, Strict, component_model

PRESET = "sik_915"
NONE = "none"


class _WithPreset(Strict):
    """Fills in what a preset says, in its parts too; a preset's name alone stands for a radio of it."""

    @model_validator(mode="before")
    @classmethod
    def _of_the_preset(cls, data: Any) -> Any:
        data = {"preset": data} if isinstance(data, str) else data
        name = data.get("preset", PRESET) if isinstance(data, dict) else None
        return _over(PRESETS[name], data) if isinstance(name, str) and name in PRESETS else data


def _over(usual: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is given, filled with what is usual."""
    both = {**usual, **given}
    for name, part in usual.items():
        if isinstance(part, Mapping) and isinstance(given.get(name), Mapping):
            both[name] = _over(part, given[name])
    return both


# Made at run time, so a type checker cannot see into it.
RadioModel: Any = component_model("radio", Network, tagged=False, base=_WithPreset)


class FleetRadioSpec(Strict):
    """What the radios of a fleet have of their own."""

    power_dbm: Finite | None = Field(None, description="transmitted [dBm]; default: that of world.radio")
    gain_db: Finite | None = Field(None, description="of the antenna [dB]; default: that of world.radio")
    noise_figure_db: Finite | None = Field(None, description="of the receiver [dB]; default: that of world.radio", ge=0)
    works: bool = Field(True, description="false, or none in place of all this: silent and deaf", strict=True)

    @model_validator(mode="before")
    @classmethod
    def _none(cls, data: Any) -> Any:
        if isinstance(data, str):
            if data != NONE:
                raise ValueError(f"is {data!r}; expected 'none', or what is different from world.radio")
            return {"works": False}
        return data
