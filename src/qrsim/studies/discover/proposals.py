"""Expression trees with constants to fit: DEAP's trees, evaluated here."""

from __future__ import annotations

import functools
import operator
import random
from typing import Any

import numpy as np

from qrsim import extras
from qrsim.core.arrays import NumpyArray
from qrsim.studies.discover.flight import LEAVES, Floats, Rule

MOST_NODES = 21
CONSTANT = "C"
_SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}


def gp() -> Any:
    """Return DEAP's module ``gp`` of genetic programming; if it is missing, raises an error that names the extra."""
    return extras.load("identify", "discovering laws", "deap.gp")


@functools.cache
def primitives(law: str) -> Any:
    """Return the DEAP primitives of a law's expression trees: + - * /, its inputs, constants."""
    known = gp().PrimitiveSet(law, 0, prefix="")
    for name in _SIGNS:
        known.addPrimitive(getattr(operator, "truediv" if name == "div" else name), 2, name=name)
    for leaf in LEAVES[law]:
        known.addTerminal(leaf, name=leaf)
    # As many constants as leaves, or trees would be made of constants alone or of none.
    for _ in LEAVES[law][:1]:
        known.addTerminal(CONSTANT, name=CONSTANT)
    return known


def text_of(tree: Any, constants: NumpyArray | None = None) -> str:
    """Write an expression tree as text with brackets; constants are c0, c1, ... or the given values."""
    words: list[str] = []
    count = 0
    for node in reversed(tree):
        if node.arity == 2:
            left, right = words.pop(), words.pop()
            words.append(f"({left} {_SIGNS[node.name]} {right})")
        elif node.name == CONSTANT:
            words.append(f"@{count}@")
            count += 1
        else:
            words.append(node.name)
    text = words[0]
    # Counted from the end, because the tree was read from there.
    for i in range(count):
        number = count - 1 - i
        text = text.replace(f"@{i}@", f"c{number}" if constants is None else f"({float(constants[number])!r})")
    return text


def count_constants(tree: Any) -> int:
    """Count the constants in an expression tree."""
    return sum(node.name == CONSTANT for node in tree)


@functools.lru_cache(maxsize=20_000)
def _compiled(text: str, constants: int, law: str) -> Rule:
    """Compile an expression in constants c0, c1, ... and a law's inputs to a function of them."""
    arguments = ", ".join([*(f"c{i}" for i in range(constants)), *LEAVES[law]])
    # The text is made above from a tree: brackets, four signs, and names of this file.
    rule: Rule = eval(f"lambda {arguments}: {text}", {"__builtins__": {}})
    return rule


def rule_of(tree: object, law: str) -> Rule:
    """Compile an expression tree to a function of its constants and the law's inputs."""
    return _compiled(text_of(tree), count_constants(tree), law)


def made(law: str) -> Any:
    """Return a random expression tree (DEAP) for a law."""
    library = gp()
    return library.PrimitiveTree(library.genHalfAndHalf(primitives(law), 1, 3))


def varied(first: object, second: object, law: str) -> object:
    """Return a child of two expression trees by crossover and mutation, within the size limit."""
    library = gp()
    known = primitives(law)
    for _ in range(8):
        child, other = library.PrimitiveTree(first), library.PrimitiveTree(second)
        kind = random.random()
        if kind < 0.5 and len(child) > 1 and len(other) > 1:
            child, _ = library.cxOnePoint(child, other)
        elif kind < 0.7:
            grow = functools.partial(library.genFull, min_=0, max_=2)
            (child,) = library.mutUniform(child, expr=grow, pset=known)
        elif kind < 0.9:
            # A further term: the change that leads most often from an approximation to the law.
            leaf = known.mapping[random.choice(LEAVES[law])]
            times, constant = known.mapping["mul"], known.mapping[CONSTANT]
            term = [times, constant, leaf] if random.random() < 0.7 else [times, constant, times, leaf, leaf]
            child = library.PrimitiveTree([known.mapping["add"], *child, *term])
        elif kind < 0.95:
            (child,) = library.mutShrink(child)
        else:
            (child,) = library.mutNodeReplacement(child, pset=known)
        if len(child) <= MOST_NODES:
            return child
    return library.PrimitiveTree(first)


def symbolic(tree: object, constants: Floats) -> object:
    """Convert an expression tree with its constants to a SymPy expression, expanded if it is a polynomial."""
    sympy = extras.load("identify", "printing laws", "sympy")
    return sympy.expand(sympy.sympify(text_of(tree, constants)))


def monomials(expression: object, law: str) -> dict[tuple[int, ...], float] | None:
    """Return powers of a law's inputs -> coefficient, of a polynomial; None for other expressions."""
    sympy = extras.load("identify", "printing laws", "sympy")
    try:
        terms = sympy.Poly(sympy.cancel(expression), *(sympy.Symbol(leaf) for leaf in LEAVES[law]))
    except sympy.PolynomialError:
        return None
    return {powers: float(value) for powers, value in terms.terms() if value != 0}


def polynomial_tree(powers: list[tuple[int, ...]], law: str) -> object:
    """Build an expression tree: the sum of terms, each a constant times the given powers of a law's inputs."""
    library = gp()
    known = primitives(law)
    add, times = known.mapping["add"], known.mapping["mul"]

    def term(each: tuple[int, ...]) -> list[object]:
        """Return the nodes of one term: a constant times powers of the inputs."""
        factors = [known.mapping[leaf] for leaf, power in zip(LEAVES[law], each, strict=True) for _ in range(power)]
        nodes = [known.mapping[CONSTANT]]
        for factor in factors:
            nodes = [times, *nodes, factor]
        return nodes

    nodes = term(powers[0])
    for each in powers[1:]:
        nodes = [add, *nodes, *term(each)]
    return library.PrimitiveTree(nodes)


def shown(expression: Any, digits: int = 6) -> str:
    """Return a SymPy expression as text, with numbers rounded to ``digits``."""
    sympy = extras.load("identify", "printing laws", "sympy")
    return str(expression.xreplace({n: sympy.Float(n, digits) for n in expression.atoms(sympy.Float)}))


def randomly(count: int) -> Floats:
    """Return ``count`` random initial values for constants in a fit."""
    return np.array([random.uniform(-1.0, 1.0) for _ in range(count)])
