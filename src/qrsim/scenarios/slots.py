"""Slots: places in a scenario where one of several components goes.

There are more than a hundred components, and a scenario names about ten. The pydantic schema of a component is made
when a scenario names it first, or when the schema of all is asked for, because each takes milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from functools import partial
from typing import ClassVar

from pydantic import GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from qrsim.scenarios.component_schema import Strict, component_model

Maker = Callable[[], type[Strict]]


class Slot:
    """Base of the annotation of a slot.

    Attributes:
        makers: returns a function for each name that may stand here, which makes its schema once.
        key: the key that tells them apart.
    """

    makers: ClassVar[Callable[[], Mapping[str, Maker]]]
    key: ClassVar[str]

    @classmethod
    def names(cls) -> list[str]:
        """Return the type names of components that this place of the schema accepts."""
        return list(cls.makers())

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: object) -> CoreSchema:
        choices: dict[Hashable, CoreSchema] = {
            # pydantic joins what the inner schema finds to its own errors, with the path.
            name: core_schema.no_info_plain_validator_function(partial(_validated, make))
            for name, make in cls.makers().items()
        }
        return core_schema.tagged_union_schema(choices, discriminator=cls.key)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        choices: dict[Hashable, CoreSchema] = {
            name: make().__pydantic_core_schema__ for name, make in cls.makers().items()
        }
        return handler(core_schema.tagged_union_schema(choices, discriminator=cls.key))


def _validated(make: Maker, value: object) -> Strict:
    """Validate a value with the pydantic model that ``make`` returns."""
    return make().model_validate(value)


def slot(makers: Callable[[], Mapping[str, Maker]], key: str = "type") -> object:
    """Return the pydantic annotation of a place for components; the value of ``key`` selects a model in ``makers``."""
    return type("Slot", (Slot,), {"makers": staticmethod(makers), "key": key})


def slot_of(choices: Mapping[str, type], *, each: bool = False, more: Mapping[str, object] | None = None) -> object:
    """Return the pydantic annotation of a place for components of ``choices``; ``each``: one number per vehicle too."""
    made: dict[tuple[str, type], type[Strict]] = {}

    def make(name: str, component: type) -> type[Strict]:
        """Return the pydantic model of a component class, cached by name and class."""
        if (name, component) not in made:
            made[name, component] = component_model(name, component, each=each, more=more)
        return made[name, component]

    return slot(lambda: {name: partial(make, name, component) for name, component in choices.items()})
