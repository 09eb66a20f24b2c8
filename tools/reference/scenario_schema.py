"""The pages of the keys of scenarios and studies: trees, with examples from those that come with qrsim."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import yaml

import qrsim.scenarios
import qrsim.studies.sweep
from tools.reference.components import anchor, page_of
from tools.reference.schema import Node, alternatives, bounds_of, kinds, resolved, schema, study_schema, type_of
from tools.reference.tables import number, page, sentence

LONGEST_EXAMPLE = 60


def pages() -> Mapping[str, str]:
    """Return the page of scenarios and that of studies."""
    scenario = """The keys of a scenario file, as a tree. Each line gives the meaning, the type, the bounds, the default
        and an example. Keys that take a component link to its types. [Writing a
        scenario](../howto/write_a_scenario.md) explains how the parts work together, and `qrsim schema`
        prints the same as a JSON schema for editors."""
    study = """The keys of a study file, as a tree: a scenario, the parameters that vary, and the metrics to keep. Each
        line gives the meaning, the type, the bounds, the default and an example. [Studies and
        sweeps](../howto/own_study.md) explains how to fly one."""
    return {
        "scenario_schema.md": page("Keys of a scenario", scenario, *_tree(schema())),
        "study_schema.md": page("Keys of a study", study, *_tree(study_schema())),
    }


def _tree(root: Node) -> list[str]:
    """Return the plain keys of a file under one heading, and each key with keys below it under its own."""
    plain, parts = [], []
    for name, node in root["properties"].items():
        lines = list(_lines(name, node, name in root.get("required", []), 0))
        if _below(name, resolved(node)):
            parts.append(f"## {name}\n\n" + "\n".join(lines))
        else:
            plain += lines
    return ["## Top level\n\n" + "\n".join(plain), *parts]


def _lines(path: str, node: Node, required: bool, depth: int) -> Iterator[str]:
    """Yield the line of a key, and those of the keys below it."""
    target = resolved(node)
    name = path.rsplit(".", 1)[-1]
    indent = "    " * depth
    unit = target.get("unit", "")
    kind = next((kind for kind in kinds() if kind.place in (path, f"{path}[]", f"{path}.NAME")), None)
    about = sentence(node.get("description", target.get("description", ""))).rstrip(".")
    about += f" [{unit}]" if unit not in ("", "1") and "[" not in about else ""
    if kind is not None:
        link = f"[type of {kind.name}](" + f"{page_of(kind)}.md#{anchor(kind)})"
        usual = f"; default `{kind.default}`" if kind.default else ""
        yield f"{indent}- `{name}`: {about}. A {link}{usual}."
        return
    facts = [type_of(target), bounds_of(target)]
    facts.append("required" if required else _default(node))
    yield (
        f"{indent}- `{name}`: {about}. "
        + sentence("; ".join(fact for fact in facts if fact))
        + "."
        + _example(path, target)
    )
    for inner_path, inner in _below(path, target):
        for key, value in inner.get("properties", {}).items():
            twin = f"{key.removesuffix('_deg')}_rad"
            if key.endswith("_deg") and twin in inner["properties"]:
                continue
            yield from _lines(f"{inner_path}.{key}", value, key in inner.get("required", []), depth + 1)


def _below(path: str, node: Node) -> list[tuple[str, Node]]:
    """Return the objects inside a key, with their paths."""
    if "properties" in node:
        return [(path, node)]
    if isinstance(node.get("additionalProperties"), dict):
        return _below(f"{path}.NAME", resolved(node["additionalProperties"]))
    for form in alternatives(node):
        inner = resolved(form.get("items", {})) if form.get("type") == "array" else form
        if "discriminator" not in inner and "properties" in inner:
            return [(f"{path}[]" if form.get("type") == "array" else path, inner)]
    return []


def _default(node: Node) -> str:
    if "default" not in node or node["default"] in ("", None, []):
        return ""
    text = number(node["default"])
    return f"default `{text}`" if len(text) <= LONGEST_EXAMPLE else ""


def _example(path: str, node: Node) -> str:
    """Return an example that a scenario gives; none for keys with keys below, whose examples those are."""
    if "properties" in node or node.get("additionalProperties"):
        return ""
    found = _given().get(path, ())
    short = [text for text in found if len(text) <= LONGEST_EXAMPLE]
    return f" Example: `{path.rsplit('.', 1)[-1]}: {min(short, key=len)}`" if short else ""


@cache
def _given() -> dict[str, tuple[str, ...]]:
    """Return path -> values in the scenarios that come with qrsim."""
    folders = (Path(qrsim.scenarios.__file__).parent, Path(qrsim.studies.sweep.__file__).parent)
    found: dict[str, tuple[str, ...]] = {}

    def walk(value: Any, path: str) -> None:
        text = yaml.safe_dump(value, default_flow_style=True, width=1000).removesuffix("\n...\n").strip()
        found.setdefault(path, ())
        found[path] += (text,)
        if isinstance(value, dict):
            for key, inner in value.items():
                walk(
                    inner, f"{path}.{'NAME' if path in ('fleets', 'fleets.NAME.sensors', 'vary') else key}".lstrip(".")
                )
        elif isinstance(value, list):
            for inner in value:
                if isinstance(inner, dict):
                    walk(inner, f"{path}[]")

    for file in sorted(file for folder in folders for file in folder.rglob("*.yaml")):
        walk(yaml.safe_load(file.read_text("utf-8")), "")
    return found
