"""The numbers that src/qrsim/models and src/qrsim/control state, and what each is changed to.

A mutant is one numeric literal of the syntax tree (a default of a parameter is one too), made 20 % larger or given the
other sign. EXCLUDED lists what is left out and why; _equivalent_mutants.py lists single mutants that change nothing.
"""

from __future__ import annotations

import ast
import itertools
import random
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from evidence._equivalent_mutants import EQUIVALENT

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src"
FOLDERS = ("qrsim/models", "qrsim/control")
MUTATIONS = ("larger", "sign")
# Rule: why such literals are no mutants. The first rule that holds is the one that counts.
EXCLUDED = {
    "zero": "nought has no 20 % and no sign",
    "message": "a number in a text that is formatted is read by people only",
    "annotation": "the types of annotations do not compute",
    "index": "a place in a sequence is structure, and what stands there has its own tests",
    "axis": "an axis is structure: arrays have other shapes with another one, or the same result",
    "shape": "a count of elements or of turns of a loop is structure, which no result states as a quantity",
    "exponent": "a whole exponent is the form of an equation (a square, a cube), not a number of it",
    "cache": "how much is remembered changes no result",
    "tolerance": "a guard against division by nought, 1e-9 and below: 20 % of it are below what arithmetic resolves",
    "stand-in": "the same condition throws it away, as in where(c, a / where(c, b, 1.0), 0.0): no result depends on it",
    "equivalent": "the mutant computes the same, by the reason that is listed with it",
}
_SHAPE_CALLS = {"zeros", "ones", "empty", "eye", "identity", "reshape", "broadcast_to", "range", "arange", "tile"}
# Of random numbers: more would be drawn and not be used.
_SHAPE_CALLS |= {"normals", "normal_rows"}
# Positions from which on arguments of these are axes.
_AXIS_CALLS = {"concatenate": 1, "stack": 1, "moveaxis": 1, "swapaxes": 1, "expand_dims": 1, "squeeze": 1, "take": 2}
_AXIS_WORDS = {"axis", "axes", "axis1", "axis2", "ndim", "ndmin", "in_axes", "out_axes", "dimension", "stacklevel"}
_SHAPE_WORDS = {"shape", "size", "length", "num", "num_segments", "total_repeat_length", "unroll", "n_derivatives"}
_GUARDS = {"maximum", "minimum", "where", "max", "min", "clip"}
_TOLERANCE = 1e-9
_BOUNDS = ("minimum", "maximum", "above")
# Where a node of the syntax tree has an annotation.
_ANNOTATED = ("annotation", "returns")


class Literal(NamedTuple):
    """A number in the source.

    Attributes:
        file: below src/.
        line, column: from 1 and from 0, in characters.
        text: as it is written, without its sign.
        owner: the innermost function or class round it, qualified by what is round that with dots; "" outside.
        kind: "function", "class" or "module", what the owner is; "bound" for what a parameter may be.
        rule: the key of EXCLUDED that leaves it out, "" where it is a mutant.
    """

    file: str
    line: int
    column: int
    text: str
    owner: str
    kind: str
    rule: str


class Mutant(NamedTuple):
    """A literal with another value.

    Attributes:
        literal: what is changed.
        mutation: one of MUTATIONS.
        key: file, text of the line, which of the lines with this text, column in it and mutation; it outlives edits of
            other lines.
        new: what stands there instead.
    """

    literal: Literal
    mutation: str
    key: tuple[str, str, int, int, str]
    new: str

    def __str__(self) -> str:
        """Return place and text."""
        literal = self.literal
        return f"src/{literal.file}:{literal.line}: {literal.text} -> {self.new} in `{self.key[1]}`"


def changed(text: str, mutation: str) -> str:
    """Return a literal 20 % larger, a whole number by at least one, or with the other sign."""
    value = ast.literal_eval(text)
    if mutation == "sign":
        return f"(-{text})"
    return str(max(value + 1, round(1.2 * value))) if isinstance(value, int) else repr(1.2 * value)


def _name(node: ast.expr) -> str:
    """Return the last name of what is called."""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _rule_of_call(call: ast.Call, child: ast.AST, value: float) -> str:
    """Return the rule by which a call leaves out what stands in its argument ``child``."""
    name = _name(call.func)
    if isinstance(child, ast.keyword):
        if child.arg in _AXIS_WORDS:
            return "axis"
        if child.arg in _SHAPE_WORDS:
            return "shape"
        return "cache" if name == "lru_cache" else ""
    place = next((k for k, argument in enumerate(call.args) if argument is child), -1)
    if name in _SHAPE_CALLS or (name == "full" and place == 0):
        return "shape"
    if name in _AXIS_CALLS and place >= _AXIS_CALLS[name]:
        return "axis"
    if name in _GUARDS and abs(value) <= _TOLERANCE:
        return "tolerance"
    return "cache" if name == "lru_cache" else ""


def _stands_in(path: list[ast.AST], node: ast.Constant) -> bool:
    """Return whether a literal is a branch of where(c, ...) inside the other branch of another one of the same c."""
    literal: ast.AST = node
    child: ast.AST = node
    condition, branch = "", 0
    for parent in reversed(path):
        if isinstance(parent, ast.UnaryOp) and child is literal:
            literal = parent
        elif isinstance(parent, ast.Call) and _name(parent.func) == "where" and child in parent.args[1:]:
            place = parent.args.index(child)  # type: ignore[arg-type]
            words = ast.unparse(parent.args[0])
            if child is literal:
                condition, branch = words, place
            elif words == condition and place != branch:
                return True
        elif isinstance(parent, ast.stmt) or child is literal:
            return False
        child = parent
    return False


def _rule(path: list[ast.AST], node: ast.Constant) -> str:
    """Return the rule that leaves out a literal, whose ancestors are given, outermost first; "" for a mutant."""
    if node.value == 0:
        return "zero"
    if any(child is getattr(parent, word, None) for parent, child in pairwise(path) for word in _ANNOTATED):
        return "annotation"
    if _stands_in(path, node):
        return "stand-in"
    # Whether all between the literal and the present ancestor only groups it or computes with it.
    child: ast.AST = node
    direct = True
    for parent in reversed(path):
        if isinstance(parent, ast.JoinedStr):
            return "message"
        if direct and isinstance(parent, ast.Subscript) and child is parent.slice:
            return "index"
        if direct and isinstance(parent, ast.Call) and (rule := _rule_of_call(parent, child, node.value)):
            return rule
        if isinstance(parent, ast.BinOp) and isinstance(parent.op, ast.Pow) and child is parent.right:
            return "exponent" if direct and isinstance(node.value, int) else ""
        direct &= isinstance(parent, ast.UnaryOp | ast.Tuple | ast.List | ast.Slice | ast.keyword | ast.BinOp)
        child = parent
    return ""


def _walk(node: ast.AST, path: list[ast.AST]) -> Iterator[tuple[ast.Constant, list[ast.AST]]]:
    for child in ast.iter_child_nodes(node):
        inner = [*path, node]
        if isinstance(child, ast.Constant):
            if isinstance(child.value, int | float) and not isinstance(child.value, bool):
                yield child, inner
        else:
            yield from _walk(child, inner)


@cache
def literals(text: str, file: str) -> tuple[Literal, ...]:
    """Return the numeric literals of a module's text, in its order, those that a rule leaves out too."""
    found = []
    lines = text.splitlines()
    for node, path in _walk(ast.parse(text), []):
        owners = [item for item in path if isinstance(item, ast.FunctionDef | ast.ClassDef)]
        rule = _rule(path, node)
        # Positions in formatted texts are not those of the file before Python 3.12.
        line = lines[node.lineno - 1].encode()
        column = len(line[: node.col_offset].decode(errors="ignore"))
        written = line[node.col_offset : node.end_col_offset].decode(errors="ignore")
        kind = "module" if not owners else "class" if isinstance(owners[-1], ast.ClassDef) else "function"
        outer = path[-2] if isinstance(path[-1], ast.UnaryOp) else path[-1]
        if isinstance(outer, ast.keyword) and outer.arg in _BOUNDS:
            kind = "bound"
        owner = ".".join(item.name for item in owners)
        found.append(Literal(file, node.lineno, column, written, owner, kind, rule))
    return tuple(sorted(found, key=lambda item: (item.line, item.column)))


def mutants_of(text: str, file: str) -> list[Mutant]:
    """Return the mutants of a module's text, without those that are listed as equivalent."""
    lines = text.splitlines()
    # Which of the lines with the same text each is.
    seen: Counter[str] = Counter()
    ordinals = []
    for line in lines:
        ordinals.append(seen[line.strip()])
        seen[line.strip()] += 1
    found = []
    for literal, mutation in itertools.product(literals(text, file), MUTATIONS):
        line = lines[literal.line - 1]
        column = literal.column - (len(line) - len(line.lstrip()))
        key = (file, line.strip(), ordinals[literal.line - 1], column, mutation)
        if not literal.rule and (file, line.strip(), column, mutation) not in EQUIVALENT:
            found.append(Mutant(literal, mutation, key, changed(literal.text, mutation)))
    return found


def files() -> list[str]:
    """Return the modules that are studied, below src/."""
    return [str(path.relative_to(SOURCE)) for folder in FOLDERS for path in sorted((SOURCE / folder).rglob("*.py"))]


def all_mutants() -> list[Mutant]:
    """Return every mutant, by file and line."""
    return [mutant for file in files() for mutant in mutants_of((SOURCE / file).read_text("utf-8"), file)]


def left_out() -> dict[str, int]:
    """Return how many literals each rule leaves out; of 'equivalent', how many mutants."""
    counts = Counter(item.rule for file in files() for item in literals((SOURCE / file).read_text("utf-8"), file))
    return {rule: len(EQUIVALENT) if rule == "equivalent" else counts[rule] for rule in EXCLUDED}


def mutated(text: str, mutant: Mutant) -> str:
    """Return a module's text with the mutant in it."""
    lines = text.splitlines(keepends=True)
    place = mutant.literal
    line = lines[place.line - 1]
    end = place.column + len(place.text)
    assert line[place.column : end] == place.text, str(mutant)
    lines[place.line - 1] = line[: place.column] + mutant.new + line[end:]
    return "".join(lines)


def sample(mutants: list[Mutant], number: int, seed: int) -> list[Mutant]:
    """Return some of the mutants, drawn by a seed, in their order."""
    chosen = random.Random(seed).sample(range(len(mutants)), min(number, len(mutants)))
    return [mutants[k] for k in sorted(chosen)]
