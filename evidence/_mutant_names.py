"""Which functions of the package mention what a number defines: who may compute with a constant or a default."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from functools import cache
from typing import NamedTuple

from evidence._mutants import SOURCE, Literal

Function = tuple[str, str]


class Definition(NamedTuple):
    """A statement outside of the bodies of functions.

    Attributes:
        first, last: its lines.
        names: what it defines.
        mentions: names that importing it looks up.
        node: of the syntax tree, where it assigns at the level of the module; else None.
    """

    first: int
    last: int
    names: frozenset[str]
    mentions: frozenset[str]
    node: ast.stmt | None = None


@cache
def _text(file: str) -> str:
    return (SOURCE / file).read_text("utf-8")


@cache
def _tree(file: str) -> ast.Module:
    return ast.parse(_text(file))


@cache
def sources() -> tuple[str, ...]:
    """Return all modules of the package, below src/."""
    return tuple(str(path.relative_to(SOURCE)) for path in sorted((SOURCE / "qrsim").rglob("*.py")))


@cache
def users(file: str) -> tuple[str, ...]:
    """Return a module and those of the package that import something of it."""
    name = re.escape(file.removesuffix(".py").replace("/", ".").removesuffix(".__init__"))
    parent, _, last = name.rpartition("\\.")
    pattern = re.compile(rf"(from|import) {name}\b|from {parent} import [^\n]*\b{last}\b")
    return (file, *(other for other in sources() if pattern.search(_text(other))))


def _names(*nodes: ast.AST | None) -> frozenset[str]:
    """Return the names of variables and attributes in nodes."""
    found = (item for node in nodes if node is not None for item in ast.walk(node))
    names = (item.id if isinstance(item, ast.Name) else getattr(item, "attr", "") for item in found)
    return frozenset(name for name in names if name)


@cache
def definitions(file: str) -> tuple[Definition, ...]:
    """Return the statements of a module's body and of its classes."""
    found = []
    left: list[tuple[ast.stmt, bool]] = [(node, True) for node in _tree(file).body]
    while left:
        node, outer = left.pop()
        names: frozenset[str] = frozenset()
        mentions, kept = _names(node), None
        if isinstance(node, ast.ClassDef):
            left += [(inner, False) for inner in node.body]
            names = frozenset({node.name})
            mentions = _names(*node.bases, *node.decorator_list, *(word.value for word in node.keywords))
        elif isinstance(node, ast.FunctionDef):
            names = frozenset({node.name})
            mentions = _names(*node.decorator_list, *node.args.defaults, *node.args.kw_defaults)
        elif isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign):
            names = _names(*(node.targets if isinstance(node, ast.Assign) else [node.target]))
            kept = node if outer else None
        elif isinstance(node, ast.Import | ast.ImportFrom):
            continue
        found.append(Definition(node.lineno, node.end_lineno or node.lineno, names, mentions, kept))
    return tuple(found)


def defined(literal: Literal) -> set[str]:
    """Return the names that a literal outside of a function's body goes into, by way of others of its module too."""
    around = [item for item in definitions(literal.file) if item.first <= literal.line <= item.last]
    if not around:
        return set()
    found = {*min(around, key=lambda item: item.last - item.first).names}
    while new := {
        name for item in definitions(literal.file) if item.mentions & found for name in item.names if name not in found
    }:
        found |= new
    return found


@cache
def _mentioned(file: str) -> dict[str, frozenset[Function]]:
    """Return by name the functions of a module that mention it, as a variable, an attribute or a keyword."""
    found: dict[str, set[Function]] = defaultdict(set)

    def walk(node: ast.AST, owner: str) -> None:
        for child in ast.iter_child_nodes(node):
            inner = owner
            if isinstance(child, ast.ClassDef | ast.FunctionDef):
                inner = f"{owner}.{child.name}".lstrip(".")
            for word in ("id", "attr", "arg"):
                name = getattr(child, word, None)
                if isinstance(name, str):
                    found[name].add((file, owner))
            walk(child, inner)

    walk(_tree(file), "")
    return {name: frozenset(functions) for name, functions in found.items()}


def computing(literal: Literal) -> set[Function]:
    """Return the functions that may compute with a literal: that it stands in, or that mention what it defines."""
    found = {(literal.file, literal.owner)} if literal.kind == "function" else set()
    names = defined(literal)
    for file in users(literal.file):
        for name in names:
            found |= _mentioned(file).get(name, frozenset())
    return found


def constants(literal: Literal) -> list[Definition] | None:
    """Return the assignments of a module, in their order, by which a literal reaches functions; None if by others too.

    Whoever has them anew has all that importing the changed module would change: no class, default or other module
    computes with them while it is imported.
    """
    if literal.kind != "module":
        return None
    names = defined(literal)
    for file in users(literal.file):
        if any(f"{name} as " in _text(file) for name in names):
            return None
        for item in definitions(file):
            if item.mentions & names and (item.node is None or file != literal.file):
                return None
    found = [item for item in definitions(literal.file) if item.names & names]
    return sorted(found) if all(item.node is not None for item in found) else None
