"""Words for the numbers of PX4's parameters in a scenario."""

from __future__ import annotations

from pydantic import ConfigDict, model_validator

from qrsim.control.failsafes import WORDS
from qrsim.files import Content
from qrsim.scenarios.component_schema import Strict


def _add_numbers(schema: Content) -> None:
    """Add PX4's parameter numbers to the words that a JSON schema allows, in place."""
    for name, words in WORDS.items():
        field = schema["properties"][name]
        field["enum"] = [*words, *words.values()]
        field.pop("type", None)


class PX4Numbers(Strict):
    """Base of the schema of failsafes, which take PX4's numbers for words."""

    model_config = ConfigDict(json_schema_extra=_add_numbers)

    @model_validator(mode="before")
    @classmethod
    def _words_for_numbers(cls, data: object) -> object:
        """Replace the number of a PX4 parameter in the data by the word for it; unknown numbers stay."""
        if not isinstance(data, dict):
            return data
        found = dict(data)
        for name, words in WORDS.items():
            given = found.get(name)
            if isinstance(given, int | float) and not isinstance(given, bool):
                found[name] = next((word for word, number in words.items() if number == given), given)
        return found
