"""What a scenario says of the radio between vehicles: its schema."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from qrsim.models.radio.network import Network
from qrsim.scenarios.component_schema import Finite, Strict, component_model

NONE = "none"


def _of_a_name(data: object) -> object:
    """Return {"preset": name} for the name of a radio preset; other data unchanged."""
    return {"preset": data} if isinstance(data, str) else data


# Made at run time, so a type checker cannot see into it. A preset's name alone stands for a radio of it.
RadioModel: Any = Annotated[component_model("radio", Network, tagged=False), BeforeValidator(_of_a_name)]


class FleetRadioSpec(Strict):
    """What the radios of a fleet have of their own."""

    power_dbm: Finite | None = Field(None, description="transmitted power [dBm]; default: that of world.radio")
    gain_db: Finite | None = Field(None, description="gain of the antenna [dB]; default: that of world.radio")
    noise_figure_db: Finite | None = Field(
        None, description="noise figure of the receiver [dB]; default: that of world.radio", ge=0
    )
    works: bool = Field(True, description="false, or none instead of this mapping: no radio", strict=True)

    @model_validator(mode="before")
    @classmethod
    def _none(cls, data: object) -> object:
        """Convert the text "none" to the settings of a fleet without a radio; raises ValueError for other texts."""
        if isinstance(data, str):
            if data != NONE:
                raise ValueError(f"is {data!r}; expected 'none', or values that differ from world.radio")
            return {"works": False}
        return data
