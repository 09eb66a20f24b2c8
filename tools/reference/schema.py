"""The JSON schema of scenarios, read for people: types, bounds, defaults, and the kinds of components."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from tools.reference.tables import number

Node = dict[str, Any]
_TYPES = {"number": "number", "integer": "integer", "string": "text", "boolean": "true or false", "null": "null"}


@cache
def schema() -> Node:
    """Return the schema of scenarios."""
    from qrsim.scenarios.scenario import json_schema

    return json_schema()


@cache
def study_schema() -> Node:
    """Return the schema of studies."""
    from qrsim.studies.sweep.study import StudySpec

    return StudySpec.model_json_schema()


@cache
def _definitions() -> Node:
    return {**study_schema()["$defs"], **schema()["$defs"]}


def resolved(node: Node) -> Node:
    """Return what a node refers to, with the words that stand beside the reference."""
    if "$ref" not in node:
        return node
    target: Node = _definitions()[node["$ref"].rsplit("/", 1)[-1]]
    beside = {key: value for key, value in node.items() if key != "$ref"}
    return {**target, **beside}


def alternatives(node: Node) -> list[Node]:
    """Return the forms of a node, itself if it has one."""
    forms = node.get("anyOf") or node.get("oneOf")
    return [resolved(form) for form in forms] if forms and "discriminator" not in node else [node]


def is_each(node: Node) -> bool:
    """Return whether a node takes one number, or a list with one for each vehicle."""
    forms = alternatives(node)
    lists = [form for form in forms if form.get("type") == "array"]
    return len(lists) == 1 and len(forms) > 1 and "minItems" not in lists[0] and _is_number(lists[0].get("items", {}))


def _is_number(node: Node) -> bool:
    return any(form.get("type") in ("number", "integer") for form in alternatives(resolved(node)))


def type_of(node: Node) -> str:
    """Return the type of a node in words."""
    forms = [form for form in alternatives(node) if not (is_each(node) and form.get("type") == "array")]
    return " or ".join(dict.fromkeys(_type(form) for form in forms))


def _type(form: Node) -> str:
    if "enum" in form:
        return ", ".join(f"`{each}`" for each in form["enum"])
    if "const" in form:
        return f"`{form['const']}`"
    if "discriminator" in form:
        return "component"
    if form.get("type") == "array":
        count = form.get("minItems") if form.get("minItems") == form.get("maxItems") else None
        inner = type_of(resolved(form.get("items", {})))
        return f"list of {count} {inner}s" if count and inner == "number" else f"list of {inner}" if inner else "list"
    if form.get("type") == "object" or "properties" in form:
        return "keys"
    return _TYPES.get(form.get("type", ""), "any value" if not form.get("type") else str(form["type"]))


def bounds_of(node: Node) -> str:
    """Return the bounds of the first form of a node that has any."""
    for form in alternatives(node):
        inner = resolved(form.get("items", {})) if form.get("type") == "array" else form
        for each in alternatives(inner):
            low = [f"≥ {number(each['minimum'])}"] if "minimum" in each else []
            low += [f"> {number(each['exclusiveMinimum'])}"] if "exclusiveMinimum" in each else []
            high = [f"≤ {number(each['maximum'])}"] if "maximum" in each else []
            high += [f"< {number(each['exclusiveMaximum'])}"] if "exclusiveMaximum" in each else []
            if low or high:
                return ", ".join(low + high)
    return ""


def choices_of(node: Node) -> str:
    """Return the values of a node that takes one of a few, "" for others."""
    found = [f"`{each}`" for form in alternatives(node) for each in form.get("enum", [])]
    return ", ".join(found)


@dataclass(frozen=True)
class Kind:
    """Components of which a scenario chooses one.

    Attributes:
        place: path of the key that takes one of them, such as ``world.wind``.
        about: description of that key.
        default: type that counts where the scenario names none.
        types: name of the type -> its schema.
    """

    place: str
    about: str
    default: str
    types: dict[str, Node]

    @property
    def name(self) -> str:
        """Last word of the place."""
        return self.place.removesuffix("[]").removesuffix(".NAME").rsplit(".", 1)[-1]


@cache
def kinds() -> list[Kind]:
    """Return every kind of component, in the order of the scenario's keys."""
    found: dict[tuple[str, ...], Kind] = {}
    seen: set[str] = set()

    def walk(node: Node, place: str, about: str) -> None:
        if "$ref" in node:
            if node["$ref"] in seen:
                return
            seen.add(node["$ref"])
        node = resolved(node)
        about = node.get("description", about) if place.count(".") <= 2 else about
        if "discriminator" in node:
            types = {name: resolved({"$ref": to}) for name, to in node["discriminator"]["mapping"].items()}
            default = (node.get("default") or {}).get("type", "") if isinstance(node.get("default"), dict) else ""
            found.setdefault(tuple(types), Kind(place, about, default, types))
            return
        for name, inner in node.get("properties", {}).items():
            walk(inner, f"{place}.{name}".lstrip("."), inner.get("description", ""))
        if isinstance(node.get("additionalProperties"), dict):
            walk(node["additionalProperties"], f"{place}.NAME", about)
        if "items" in node:
            walk(node["items"], f"{place}[]", about)
        for form in node.get("anyOf", []) + node.get("oneOf", []):
            walk(form, place, about)

    walk(schema(), "", "")
    return list(found.values())


def parameters(node: Node, prefix: str = "") -> Iterator[tuple[str, Node, bool]]:
    """Yield (dotted name, schema, whether it is required) of a component's parameters; degrees only where alone."""
    required = node.get("required", [])
    properties = node.get("properties", {})
    for name, inner in properties.items():
        twin = f"{name.removesuffix('_deg')}_rad"
        if name == "type" or (name.endswith("_deg") and twin in properties):
            continue
        target = resolved(inner)
        if "properties" in target:
            yield from parameters(target, f"{prefix}{name}.")
        else:
            yield prefix + name, target, name in required
