"""An extension of griffe that documents the fields of records, and prepares other docstrings for the site.

Fields declare their sentence, unit, bounds and default as arguments of ``parameter``, ``setting``, ``quantity`` or
``derived``. The extension reads these from the syntax tree, so that the API reference shows them and the package need
not be imported.
"""

from __future__ import annotations

import ast
import re
from typing import Any

from griffe import Attribute, Docstring, Extension, Object

MAKERS = ("parameter", "setting", "quantity", "derived")
BOUNDS = {"minimum": "at least", "above": "above", "maximum": "at most"}


# Entries are on pages of docs/reference/api/.
_PAGE = re.compile(r"(?<![\w/\[`])(?<!\]\()docs/([\w/]+\.md)")

# An entry of a section, and the lines that go on with it. Functions may not join parameters: griffe warns of them.
_JOINED = re.compile(r"^( +)(\w+(?:, \w+)+): (.*(?:\n\1 +.*)*)", re.MULTILINE)


class RecordFields(Extension):
    """Gives each field of a record a docstring made of its declaration."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Make links of the pages that a docstring names, and give each of several attributes an entry."""
        if obj.docstring is not None:
            text = _PAGE.sub(r"[docs/\1](../../\1)", obj.docstring.value)
            obj.docstring.value = text if obj.is_function else _JOINED.sub(_entries, text)

    def on_attribute_instance(self, *, node: Any, attr: Attribute, **_: Any) -> None:
        """Set the docstring of one field, and drop the declaration as its value."""
        call = node.value if isinstance(node, ast.AnnAssign) else None
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in MAKERS:
            attr.docstring = attr.docstring or Docstring(sentence(call), parent=attr)
            attr.value = None


def _entries(found: re.Match[str]) -> str:
    """Return an entry for each name of one that joins several."""
    indent, names, text = found.groups()
    return "\n".join(f"{indent}{name}: {text}" for name in names.split(", "))


def sentence(call: ast.Call) -> str:
    """Return the documentation of a field from its declaration: meaning, unit, bounds, default."""
    given = {keyword.arg: keyword.value for keyword in call.keywords}
    if call.args:
        given["default"] = call.args[0]

    def text(name: str) -> str:
        value = given.get(name)
        return str(value.value) if isinstance(value, ast.Constant) and isinstance(value.value, str) else ""

    meaning = text("doc")
    head = meaning[:1].upper() + meaning[1:] + (f" [{text('unit')}]" if text("unit") else "")
    bounds = [f"{word} {ast.unparse(given[name])}" for name, word in BOUNDS.items() if name in given]
    if "default" in given and call.func.id != "derived":  # type: ignore[attr-defined]
        bounds.append(f"default {ast.unparse(given['default'])}")
    return "; ".join([head, *bounds])
