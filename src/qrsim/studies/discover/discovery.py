"""From a log to laws: evolution on the first part, scores on the rest."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jax import Array

from qrsim.errors import LogError, RunError
from qrsim.files import Content
from qrsim.models.vehicles.quadrotor import (
    PITCH_ROLL_RAD_PER_RAW,
    THROTTLE_RAW_PER_UNIT,
    YAW_RATE_RAD_S_PER_RAW,
    Quadrotor,
)
from qrsim.studies.discover.choosing import choose
from qrsim.studies.discover.delay import refined_delay, rough_delay
from qrsim.studies.discover.evolution import SHOWS, Evolution, Proposal
from qrsim.studies.discover.flight import (
    LEAVES,
    LEFT_SIDES,
    SHOWN_BY,
    Flight,
    Floats,
    Rule,
    channels_of,
    fly,
    windows_of,
)
from qrsim.studies.discover.proposals import monomials, polynomial_tree, rule_of, shown, symbolic
from qrsim.studies.flight_logs import FlightLog
from qrsim.studies.flight_logs.excitation import described, measure, without_frozen, without_ground

TRAIN, STEPS, WINDOWS = 0.6, 15, 80
MASS = 1.68


@dataclass(frozen=True)
class Law:
    """One discovered law.

    Attributes:
        name: of the law.
        chosen: its tree and constants.
        front: (nodes, error) of the Pareto front, smallest first.
        expression: of SymPy, multiplied out.
    """

    name: str
    chosen: Proposal
    front: list[tuple[int, float]]
    expression: object

    @property
    def terms(self) -> dict[tuple[int, ...], float] | None:
        """Coefficient of each term of the law by the powers of its inputs; None if the law is not a polynomial."""
        return monomials(self.expression, self.name)

    @property
    def text(self) -> str:
        """The law's equation as text."""
        return f"{LEFT_SIDES[self.name]} = {shown(self.expression)}"


@dataclass(frozen=True)
class Discovery:
    """The discovered laws and their scores.

    Attributes:
        laws: by name.
        delay: [s] by which the commands of this log act late.
        held_out: mean squared error of each channel over the rest of the log, open loop and with that delay:
            "published", "discovered".
        flights: of the rest, (C, H) recorded and by the two sets of laws, those discovered with their trims.
        trims: added to the commands in this log, by name.
        names: of the channels.
        held: laws that stay as published, with the reason: the log does not show them, or what was found
            explains nothing of the rest.
    """

    laws: dict[str, Law]
    delay: float
    held_out: dict[str, dict[str, float]]
    flights: dict[str, Floats]
    trims: dict[str, float]
    names: tuple[str, ...]
    dt: float
    held: dict[str, str]

    def vehicle(self, mass: float) -> Content:
        """Return a vehicle with the discovered laws and a mass [kg], as the content of a vehicle file."""
        laws = {name: law for name, law in self.laws.items() if name not in self.held}
        texts = {f"{name}_law": str(law.expression) for name, law in laws.items() if name != "drag"}
        content: dict[str, object] = {"type": "expression", "mass": mass, **texts}
        drag = laws["drag"].terms if "drag" in laws else None
        # A drag that is proportional to the velocity is a constant of the vehicle; others have no place in it yet.
        if drag is not None and set(drag) == {(1,)} and drag[(1,)] < 0.0:
            content["kuv"] = drag[(1,)]
        return content


def discover(
    log: FlightLog,
    seed: int,
    generations: int,
    population: int,
    mass: float = MASS,
    train: float = TRAIN,
    delay: float | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Discovery:
    """Evolve laws of motion on the first share ``train`` of a log, score them on the rest; ``delay`` None is estimated.

    Raises:
        LogError: signals are missing, the log is too short, or shows no law.
        RunError: no law explains the rest.
    """
    log = without_frozen(without_ground(log))
    held = not_shown(log, train)
    known = {name: known_law(name) for name in held}
    for name, why in held.items():
        progress(f"{name}: as published: {why}")
    late = rough_delay(log, train, known) if delay is None else delay
    evolution = Evolution(windows_of(log.delayed(late), 0.0, train, STEPS, WINDOWS), mass, population, seed, known)
    evolution.run(generations, progress)
    if delay is None:
        likely = {name: each.chosen(evolution.windows) for name, each in evolution.populations.items()}
        late = refined_delay(log, likely, mass, train, late, known)
    log = log.delayed(late)
    choice = choose(log, evolution.populations, evolution.windows, mass, train)
    laws = {}
    for name, each in ((name, each) for name, each in evolution.populations.items() if not each.given):
        best = choice.laws[name]
        front = [(p.size, p.error) for p in each.pareto()]
        laws[name] = Law(name, best, front, symbolic(best.tree, best.constants))
    rest = _held_out(log, train)
    found = {name: (rule_of(law.tree, name), law.constants[:, None]) for name, law in choice.laws.items()}
    flights = {
        "recorded": rest.recorded[:, :, 0],
        "published": _fly_laws(rest, published(), mass, {}),
        "discovered": _fly_laws(rest, found, mass, choice.trims),
    }
    scores = {
        name: dict(
            zip(rest.names, np.mean(np.square(flights[name] - flights["recorded"]), axis=1).tolist(), strict=True)
        )
        for name in ("published", "discovered")
    }
    variance = dict(zip(rest.names, np.var(flights["recorded"], axis=1).tolist(), strict=True))
    held |= _rejected(log, laws, scores, variance)
    return Discovery(laws, late, scores, flights, choice.trims, rest.names, log.dt, held)


def not_shown(log: FlightLog, train: float) -> dict[str, str]:
    """Return law -> reason, for laws that the first fraction ``train`` of a log does not excite.

    Raises:
        LogError: it says nothing of any; its details are how much each signal moves.
    """
    rows = np.arange(len(log.time)) < round(train * len(log.time))
    excitation = measure(log, rows)
    names = channels_of(log)
    held = {}
    for law in (law for law in LEAVES if SHOWN_BY[law] in names):
        aspects = ("roll", "pitch") if law == "tilt" else (law,)
        # One law for roll and pitch: what one of them does not do as it is asked spoils it.
        deaf = [each for each in aspects if each in excitation.silent]
        if deaf or not any(each in excitation.shown for each in aspects):
            lacking = [excitation.lacking[each] for each in aspects if each in excitation.lacking]
            held[law] = "; ".join(dict.fromkeys(lacking))
    if len(held) == sum(SHOWN_BY[law] in names for law in LEAVES):
        message, details = described([log], [excitation])
        raise LogError(message, details + [f"  {name}: {why}" for name, why in held.items()])
    return held


def known_law(name: str) -> Proposal:
    """Return a law of the published model as an expression tree with its constants."""
    return Proposal(polynomial_tree(list(PUBLISHED_TERMS[name]), name), published()[name][1][:, 0], error=1.0)


def _rejected(
    log: FlightLog, laws: Mapping[str, Law], scores: Mapping[str, Mapping[str, float]], variance: Mapping[str, float]
) -> dict[str, str]:
    """Return law -> reason, for laws that predict the held-out part no better than the mean of each channel.

    What counts is the geometric mean of the errors over the variances. A law that is better than the published one is
    kept all the same.

    Raises:
        RunError: all explain nothing.
    """
    before, after = scores["published"], scores["discovered"]
    found = {}
    for name in laws:
        channels = [channel for channel in SHOWS[name] if channel in before]
        to_mean = math.prod(after[each] / max(variance[each], 1e-30) for each in channels)
        to_published = math.prod(after[each] / max(before[each], 1e-30) for each in channels)
        if not (to_mean < 1.0 or to_published < 1.0):
            told = ", ".join(f"{each} {after[each]:.3g} ({variance[each]:.3g})" for each in channels)
            found[name] = f"held-out mean squared errors are no smaller than the variances: {told}"
    if len(found) == len(laws):
        head = f"{log.source}: no law explains the held-out part, and nothing is written"
        raise RunError(head, *(f"  {name}: {why}" for name, why in found.items()))
    return found


def _held_out(log: FlightLog, train: float) -> Flight:
    """Return the part of a log after the fraction ``train`` as one window, up to its first gap."""
    rows = len(log.time)
    most = rows - round(train * rows) - 2 - 8
    for steps in (most, most // 2, most // 4, most // 8):
        try:
            return windows_of(log, train, 1.0, steps, 1)
        except ValueError:
            continue
    return windows_of(log, train, 1.0, STEPS, 1)


def _fly_laws(
    flight: Flight, laws: Mapping[str, tuple[Rule, Floats]], mass: float, trims: Mapping[str, float]
) -> Floats:
    """Simulate one window with some laws of motion; return the channels (C, H) at its H rows."""
    rules = {name: laws[name][0] for name in flight.laws}
    return fly(flight, rules, {name: laws[name][1] for name in flight.laws}, mass, trims)[:, :, 0, 0]


def published() -> dict[str, tuple[Rule, Floats]]:
    """Return law name -> (function, constants) of the published model."""
    v = Quadrotor()
    tilt, yaw = v.kpq0 * v.kpq1 / PITCH_ROLL_RAD_PER_RAW, v.kr0 / YAW_RATE_RAD_S_PER_RAW
    values: dict[str, tuple[Array, ...]] = {
        "thrust": (v.cth0, v.cth1 * THROTTLE_RAW_PER_UNIT, v.cth2 * THROTTLE_RAW_PER_UNIT**2),
        "tilt": (tilt, -v.kpq1, v.kpq2),
        "yaw": (yaw, v.kr1),
        "drag": (v.kuv,),
    }
    rules: dict[str, Rule] = {
        "thrust": lambda a, b, c, u: a + u * (b + c * u),
        "tilt": lambda a, b, c, u, angle, rate: a * u + b * angle + c * rate,
        "yaw": lambda a, b, u, rate: a * u + b * rate,
        "drag": lambda a, u: a * u,
    }
    return {name: (rules[name], np.array(values[name], np.float64)[:, None]) for name in LEAVES}


# The powers of the leaves in each published law, in the order of the constants of ``published``.
PUBLISHED_TERMS: dict[str, tuple[tuple[int, ...], ...]] = {
    "thrust": ((0,), (1,), (2,)),
    "tilt": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "yaw": ((1, 0), (0, 1)),
    "drag": ((1,),),
}


def is_published(law: Law) -> bool:
    """Return whether a law has the algebraic form of the published model's law."""
    terms = law.terms
    return terms is not None and set(terms) == set(PUBLISHED_TERMS[law.name])
