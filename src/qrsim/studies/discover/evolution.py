"""Co-evolution: a population of trees for each law; each tree is scored in flight with partners of the others.

Fitness is the error after flying many windows, against the number of nodes; parents are selected by NSGA-II. The
constants of every proposal are refined by Gauss-Newton with Levenberg's damping on that same error, its partners held.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from qrsim import extras
from qrsim.studies.discover.flight import ANGULAR, Flight, Floats, Rule, fly
from qrsim.studies.discover.proposals import (
    count_constants,
    made,
    monomials,
    polynomial_tree,
    randomly,
    rule_of,
    symbolic,
    text_of,
    varied,
)

REFINEMENTS, ROUGH_REFINEMENTS = 3, 12
# So many samples of a window count as independent where error is weighed against size.
PER_WINDOW = 5
SIMPLIFIED_EVERY, MOST_TERMS = 3, 8
FAILED = 1e12


@dataclass
class Proposal:
    """One tree with its constants.

    Attributes:
        tree: of DEAP.
        constants: (K,).
        error: mean squared error over the noise of the channels, together with the best partners it met.
        fitness: for DEAP.
    """

    tree: Any
    constants: Floats
    error: float = FAILED
    fitness: Any = None

    @property
    def size(self) -> int:
        """Number of nodes in the proposed law's expression tree."""
        return len(self.tree)


@dataclass
class Population:
    """The proposals for one law.

    Attributes:
        law: its name.
        members: of the present generation.
        front: the best proposal of each size met so far, none worse than a smaller one.
        partner: which the other laws' proposals fly with.
        known: every expression met, by its text.
        given: it does not evolve: its one proposal is what is known, because the log does not show the law.
    """

    law: str
    members: list[Proposal] = field(default_factory=list)
    front: dict[int, Proposal] = field(default_factory=dict)
    partner: Proposal | None = None
    known: dict[str, Proposal] = field(default_factory=dict)
    given: bool = False

    def pareto(self) -> list[Proposal]:
        """Return the Pareto front of error against size, smallest proposal first."""
        best: list[Proposal] = []
        for size in sorted(self.front):
            if not best or self.front[size].error < best[-1].error * (1.0 - 1e-9):
                best.append(self.front[size])
        return best

    def chosen(self, windows: int) -> Proposal:
        """Return the proposal of the front with the best trade of error and size, by an information criterion."""
        count = PER_WINDOW * windows
        return min(self.pareto(), key=lambda each: count * math.log(each.error) + 0.5 * each.size * math.log(count))


class Evolution:
    """The populations of all laws of a flight; given laws do not evolve."""

    def __init__(self, flight: Flight, mass: float, size: int, seed: int, given: Mapping[str, Proposal] | None = None):
        self.flight, self.mass, self.size = flight, mass, size
        self.populations = {
            law: Population(law, front={given[law].size: given[law]}, partner=given[law], given=True)
            if given and law in given
            else Population(law)
            for law in flight.laws
        }
        self.windows = flight.start.shape[1]
        # First what the channels move; later what the best partners leave.
        self.noise = np.std(flight.recorded - flight.recorded[:, :1], axis=(1, 2)) + 1e-9
        self.rough = {each.law: slopes(flight, each.law) for each in self._evolving()}
        self.random = random.Random(seed)

    def run(self, generations: int, progress: Callable[[str], None] = lambda text: None) -> None:
        """Evolve the laws' populations for some generations; the same seed gives the same laws."""
        before = random.getstate()
        # DEAP draws from the module's own generator.
        random.seed(self.random.random())
        try:
            self._initialise()
            for number in range(generations):
                self._generation()
                if (number + 1) % SIMPLIFIED_EVERY == 0 or number + 1 == generations:
                    self._simplify()
                told = ", ".join(
                    f"{p.law} {p.partner.error:.4g} ({p.partner.size})" for p in self._evolving() if p.partner
                )
                progress(f"generation {number + 1}: error (nodes) {told}")
        finally:
            random.setstate(before)

    def _evolving(self) -> list[Population]:
        """Return the populations of the laws that evolve, without those that are given."""
        return [each for each in self.populations.values() if not each.given]

    def _initialise(self) -> None:
        """Fill the populations with random laws, and choose the first partners to fly them with."""
        for population in self._evolving():
            population.members = [
                self._proposal_from_record(made(population.law), population.law) for _ in range(self.size)
            ]
            population.partner = min(population.members, key=lambda each: each.error)
        for population in self._evolving():
            self._judge(population, population.members)

    def _generation(self) -> None:
        """Breed, evaluate and select one generation of every population."""
        tools = extras.load("identify", "discovering laws", "deap.tools")
        for population in self._evolving():
            parents = [*population.members, *population.pareto()]
            children = []
            for _ in range(self.size):
                first, second = (min(random.sample(parents, 3), key=lambda each: each.error) for _ in range(2))
                if random.random() < 0.3:
                    first = random.choice(population.pareto())
                children.append(
                    self._proposal_from_record(varied(first.tree, second.tree, population.law), population.law)
                )
            self._judge(population, children)
            together = {text_of(each.tree): each for each in (*population.members, *children, *population.pareto())}
            population.members = tools.selNSGA2(list(together.values()), min(self.size, len(together)))
            population.partner = population.chosen(self.windows)

    def _simplify(self) -> None:
        """Expand each law's best expressions and try them with one term less, as long as that is better."""
        for population in self._evolving():
            tried: set[str] = set()
            while True:
                best = population.chosen(self.windows)
                if (text := text_of(best.tree)) in tried:
                    break
                tried.add(text)
                terms = monomials(symbolic(best.tree, best.constants), population.law)
                if not terms or len(terms) > MOST_TERMS:
                    break
                fewer = [{p: c for p, c in terms.items() if p != left} for left in terms] if len(terms) > 1 else []
                simpler = [
                    Proposal(polynomial_tree(list(each), population.law), np.array(list(each.values())))
                    for each in (terms, *fewer)
                ]
                self._judge(population, simpler)
                population.members += simpler
            population.partner = population.chosen(self.windows)

    def _proposal_from_record(self, tree: object, law: str) -> Proposal:
        """Return a tree as a proposal, with constants fitted to the recorded slopes of the law's output."""
        text = text_of(tree)
        known = self.populations[law].known
        if text not in known:
            rule, (leaves, slope) = rule_of(tree, law), self.rough[law]

            def residual(constants: Floats) -> Floats:
                """Return the law's output minus the recorded slope, for B sets of K constants (K, B)."""
                with np.errstate(all="ignore"):
                    return np.broadcast_to(
                        rule(*(c[:, None] for c in constants), *leaves) - slope, (constants.shape[1], len(slope))
                    )

            found, error = fitted(residual, randomly(count_constants(tree)) * np.std(slope), ROUGH_REFINEMENTS)
            known[text] = Proposal(tree, found, error / float(np.var(slope)))
        return known[text]

    def _judge(self, population: Population, proposals: Sequence[Proposal]) -> None:
        """Fly proposals with the best partners and with random ones; each keeps the smaller error."""
        fitness = extras.load("identify", "discovering laws", "deap.base").Fitness
        weights = type("Smaller", (fitness,), {"weights": (-1.0, -1.0)})
        for proposal in proposals:
            if proposal.fitness is None:
                together = partners_of(population.law, self.populations)
                best = {law: self.populations[law].partner for law in together}
                drawn = {law: random.choice(self.populations[law].pareto() or [p]) for law, p in sorted(best.items())}
                if any(drawn[law] is not best[law] for law in drawn):
                    other = self._flight_error(population.law, proposal, drawn, refine=False)
                else:
                    other = FAILED
                proposal.error = min(self._flight_error(population.law, proposal, best, refine=True), other)
                proposal.fitness = weights()
                proposal.fitness.values = (proposal.error, float(proposal.size))
            kept = population.front.get(proposal.size)
            if proposal.error < FAILED and (kept is None or proposal.error < kept.error):
                population.front[proposal.size] = proposal

    def _flight_error(self, law: str, proposal: Proposal, partners: dict[str, Any], refine: bool) -> float:
        """Return a proposal's mean squared error in flight; ``refine`` fits its constants to the flight first."""
        errors = errors_of(law, proposal, partners, self.flight, self.noise, self.mass, {})

        def residual(constants: Floats) -> Floats:
            """Return the errors in flight (B, ...) for B sets of K constants (K, B)."""
            return errors(constants, {}).reshape(constants.shape[1], -1)

        constants, error = fitted(residual, proposal.constants, REFINEMENTS if refine else 0)
        if refine:
            proposal.constants = constants
        return error


def errors_of(
    law: str,
    proposal: Proposal,
    partners: Mapping[str, Proposal],
    flight: Flight,
    noise: Floats,
    mass: float,
    trims: Mapping[str, float],
) -> Callable[[Floats, Mapping[str, Floats]], Floats]:
    """Return a function of constants (K, B) and trims (B,) that gives a law's errors in flight (B, C, H, n), in noise
    units.

    Args:
        law, proposal: what is tried.
        partners: of the other laws, by name.
        flight: windows.
        noise: (C,) of the flight's channels.
        mass: [kg].
        trims: by name, where the function's own do not replace them.
    """
    rules: dict[str, Rule] = {name: rule_of(each.tree, name) for name, each in partners.items()}
    rules[law] = rule_of(proposal.tree, law)
    others = {name: each.constants[:, None] for name, each in partners.items()}
    seen = flight if "drag" in rules else _relevant_part(flight, law)
    own = [i for i, name in enumerate(seen.names) if name in SHOWS[law]]
    scale = noise[[flight.names.index(seen.names[i]) for i in own]]

    def errors(constants: Floats, tried: Mapping[str, Floats]) -> Floats:
        """Return the errors (B, C, H, n) of the law's channels for constants (K, B) and trims (B,), in noise units."""
        found = fly(seen, rules, others | {law: constants}, mass, {**trims, **tried})
        if found.shape[2] != constants.shape[1]:
            found = np.broadcast_to(found, (*found.shape[:2], constants.shape[1], found.shape[3]))
        return np.moveaxis((found[own] - seen.recorded[own][:, :, None]) / scale[:, None, None, None], 2, 0)

    return errors


def _relevant_part(flight: Flight, law: str) -> Flight:
    """Return a flight with only the channels that a law affects: of rotation, or thrust."""
    wanted = ("thrust",) if law == "thrust" else ANGULAR
    rows = [i for i, name in enumerate(flight.names) if name in wanted]
    names = tuple(flight.names[i] for i in rows)
    return replace(flight, names=names, recorded=flight.recorded[rows])


def partners_of(law: str, laws: Iterable[str]) -> set[str]:
    """Return those of ``laws`` that must be flown together with a law."""
    together = TOGETHER[law] & set(laws)
    return set() if law == "thrust" and "drag" not in together else together


# Which laws act on what a law shows in: its partners. Thrust alone does not turn a body.
TOGETHER: dict[str, set[str]] = {
    "thrust": {"tilt", "yaw", "drag"},
    "tilt": {"yaw"},
    "yaw": {"tilt"},
    "drag": {"thrust", "tilt", "yaw"},
}
SHOWS = {
    "thrust": ("thrust", "velocity_down"),
    "tilt": ("roll", "pitch", "roll_rate", "pitch_rate"),
    "yaw": ("yaw", "yaw_rate"),
    "drag": ("velocity_north", "velocity_east"),
}


def fitted(residual: Callable[[Floats], Floats], start: Floats, steps: int) -> tuple[Floats, float]:
    """Fit constants (K,) by at most ``steps`` Levenberg-Marquardt steps on ``residual``; also return the mean square.

    Args:
        residual: (K, B) -> (B, N).
        start: (K,).
        steps: how many.
    """
    constants, damping = start, 1e-3
    count = len(start)
    error = FAILED
    for step in range(steps + 1):
        moves = 1e-4 * np.maximum(np.abs(constants), 1e-2) if step < steps else np.zeros(0)
        shifted = constants[:, None] + np.diag(moves) if len(moves) else np.zeros((count, 0))
        batch = np.concatenate([constants[:, None], shifted], axis=1)
        values = residual(batch if count else np.zeros((0, 1)))
        error = _mean_square(values[0])
        if error >= FAILED or step == steps or not count:
            break
        jacobian = (values[1:] - values[:1]) / moves[:, None]
        with np.errstate(all="ignore"):
            normal, gradient = jacobian @ jacobian.T, jacobian @ values[0]
        if not (np.isfinite(normal).all() and np.isfinite(gradient).all()):
            break
        scale = np.maximum(np.diag(normal), 1e-12 * max(float(np.diag(normal).max()), 1e-300))
        better = False
        for _ in range(3):
            tried = constants - np.linalg.lstsq(normal + damping * np.diag(scale), gradient, rcond=None)[0]
            if _mean_square(residual(tried[:, None])[0]) < error:
                constants, damping, better = tried, max(damping / 10.0, 1e-9), True
                break
            damping *= 10.0
        if not better:
            break
    return constants, error


def _mean_square(values: Floats) -> float:
    """Return the mean square of values, at most FAILED."""
    with np.errstate(all="ignore"):
        error = float(np.mean(np.square(values)))
    return min(error, FAILED) if math.isfinite(error) else FAILED


def slopes(flight: Flight, law: str) -> tuple[list[Floats], Floats]:
    """Return a law's inputs, (N,) each, and its outputs (N,), from differences of the recorded channels."""
    place = {name: i for i, name in enumerate(flight.names)}
    middle = slice(2, -2)

    def seen(name: str) -> Floats:
        """Return a recorded channel by name."""
        return flight.recorded[place[name]]

    def slope(values: Floats) -> Floats:
        """Return the derivative of a recorded channel, by central differences over four rows."""
        return (values[4:] - values[:-4]) / (4 * flight.dt)

    pitch, roll, throttle, yaw = flight.commands
    # A command's row acts until the row that is recorded in its place.
    later = {"pitch": pitch[1:], "roll": roll[1:], "yaw": yaw[1:]}
    if law == "thrust":
        return [throttle.ravel()], seen("thrust").ravel()
    if law == "yaw":
        return [later["yaw"][2:-1].ravel(), seen("yaw_rate")[middle].ravel()], slope(seen("yaw_rate")).ravel()
    if law == "tilt":
        leaves = [
            np.concatenate([later[axis][2:-1].ravel() for axis in ("roll", "pitch")]),
            np.concatenate([seen(axis)[middle].ravel() for axis in ("roll", "pitch")]),
            np.concatenate([seen(f"{axis}_rate")[middle].ravel() for axis in ("roll", "pitch")]),
        ]
        return leaves, np.concatenate([slope(seen(f"{axis}_rate")).ravel() for axis in ("roll", "pitch")])
    # Along north and east where the heading hardly matters: only a start for the fit in flight.
    leaves = [np.concatenate([seen(name)[middle].ravel() for name in ("velocity_north", "velocity_east")])]
    return leaves, np.concatenate([-0.5 * seen(name)[middle].ravel() for name in ("velocity_north", "velocity_east")])
