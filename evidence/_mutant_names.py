"""Which functions of the package mention what a number defines: who may compute with a constant or a default."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

from evidence._mutants import SOURCE, Literal

Function = tuple[str, str]


class Definition(NamedTuple):
    """A statement outside of functions: its first and last line, what it names, and what it mentions."""

    first: int
    last: int
    names: frozenset[str]
    mentions: frozenset[str]


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


def _names(node: ast.AST) -> Iterator[str]:
    for item in ast.walk(node):
        if isinstance(item, ast.Name):
            yield item.id


@cache
def definitions(file: str) -> tuple[Definition, ...]:
    """Return the statements of a module's body and of its classes that define something."""
    found = []
    left: list[ast.stmt] = [*_tree(file).body]
    while left:
        node = left.pop()
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names = {node.name}
            left += node.body if isinstance(node, ast.ClassDef) else []
        elif isinstance(node, ast.Assign):
            names = {name for target in node.targets for name in _names(target)}
        elif isinstance(node, ast.AnnAssign | ast.AugAssign):
            names = {*_names(node.target)}
        else:
            continue
        mentions = frozenset() if isinstance(node, ast.FunctionDef) else frozenset(_names(node))
        found.append(Definition(node.lineno, node.end_lineno or node.lineno, frozenset(names), mentions))
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
