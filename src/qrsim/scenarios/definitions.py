"""Names of the definitions in the JSON schema of scenarios.

Pydantic qualifies models of one name by their module and a number, such as those of the guidance and the controller
``attitude``. Editors show these names, so each gets that of its key as well: ``guidance_attitude``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

from qrsim.files import Content


def with_short_names(schema: Mapping[str, object]) -> dict[str, object]:
    """Return a JSON schema with its ``$defs`` renamed to short names: key in the scenario, and type.

    Args:
        schema: of scenarios, as pydantic makes it.
    """
    names: dict[str, str] = {}
    _look(schema, "", names)
    text = json.dumps(schema)
    for long, short in names.items():
        text = text.replace(f'"#/$defs/{long}"', f'"#/$defs/{short}"').replace(f'"{long}":', f'"{short}":')
    renamed: Content = json.loads(text)
    for short in names.values():
        renamed["$defs"][short]["title"] = short
    return renamed


def _look(node: object, key: str, names: dict[str, str]) -> None:
    """Collect long name -> short name of a JSON schema's definitions into ``names``; ``key`` is the key of ``node``."""
    if isinstance(node, list):
        for part in node:
            _look(part, key, names)
    elif isinstance(node, dict):
        for kind, target in node.get("discriminator", {}).get("mapping", {}).items():
            long = target.rpartition("/")[2]
            if "__" in long:
                names.setdefault(long, f"{key}_{kind}")
        for name, part in node.items():
            inside = name in ("properties", "$defs")
            for inner_key, inner in part.items() if inside and isinstance(part, dict) else ((key, part),):
                _look(inner, inner_key, names)
