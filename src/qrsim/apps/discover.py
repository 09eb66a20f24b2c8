"""``qrsim discover``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import OPTIONAL_SECONDS
from qrsim.errors import LogError, RunError, UsageError, os_error_as

if TYPE_CHECKING:
    from qrsim.studies.discover.discovery import Discovery


@dataclass(frozen=True)
class Discover:
    """Find the form of a vehicle's equations from a flight log, by co-evolutionary programming.

    Each law (commanded thrust, roll and pitch, yaw, drag) has a population of expressions (+ - x /, inputs, constants).
    Each expression is scored, and its constants are fitted, on short pieces of the first part of the log, together with
    the best expressions of the other laws. From the Pareto front of error and size, the law with the smallest error
    over seconds is selected. These laws and the Pareto front are printed.

    Example:
      qrsim discover flight.csv -o discovered.yaml
      qrsim discover flight.csv --seed 3 --generations 20 --population 40 --overwrite
    """

    log: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]
    """Flight log; see 'qrsim identify'."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o", "--output"], metavar="FILE")] = Path("discovered.yaml")
    """Vehicle to write; a picture is written next to it."""
    seed: int = 0
    """The same seed finds the same laws."""
    generations: int = 12
    """Number of generations."""
    population: int = 30
    """Expressions for each law."""
    mass: float = 1.68
    """Take-off mass [kg]."""
    delay: Annotated[float | None, OPTIONAL_SECONDS, tyro.conf.arg(help_behavior_hint="(default: estimated)")] = None
    """Delay of the commands."""
    train: float = 0.6
    """Share of the log that is used; the rest scores the laws."""
    boot: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: most messages)")] = None
    """Number of the boot, from 1, in a DataFlash log with several."""
    overwrite: bool = False
    """Replace FILE if it exists."""
    quiet: bool = False
    """Print no progress."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Run ``qrsim discover``: read the log, search for equations of motion, and write and print the result."""
        self._check()
        from qrsim.files.atomic import write_atomically
        from qrsim.runs.picture import save_picture
        from qrsim.scenarios.reading import dump_yaml
        from qrsim.studies.discover.discovery import discover
        from qrsim.studies.discover.picture import draw
        from qrsim.studies.flight_logs import read_log

        log = read_log(self.log, boot=self.boot)
        say: Callable[[str], None] = (
            (lambda text: None) if self.quiet or self.json else (lambda text: print(text, flush=True))
        )
        for line in (f"{log.source} ({log.kind})", *(f"  {note}" for note in log.notes)):
            say(line)
        try:
            found = discover(log, self.seed, self.generations, self.population, self.mass, self.train, self.delay, say)
        except LogError as error:
            for line in error.details:
                say(line)
            raise
        content = dump_yaml({"vehicle": found.vehicle(self.mass), "discovered": _summary(found)})
        head = f"# Discovered by 'qrsim discover' from {self.log.name}, seed {self.seed}.\n"
        with os_error_as(RunError, f"cannot write {self.out}"):
            write_atomically(self.out, (head + content).encode())
        save_picture(lambda: draw(found), self.out.with_suffix(".png"))
        if self.json:
            import json

            print(json.dumps(_summary(found) | {"vehicle": str(self.out)}, indent=2))
        else:
            _print(found, self.out)

    def _check(self) -> None:
        """Raise UsageError for options that are out of range or do not go together."""
        if self.out.suffix not in (".yaml", ".yml"):
            raise UsageError(f"--out {self.out}: expected a name that ends in .yaml")
        if self.out.exists() and not self.overwrite:
            raise UsageError(f"{self.out}: exists already; --overwrite replaces it")
        if not self.out.parent.is_dir():
            raise UsageError(f"{self.out}: the folder {self.out.parent} does not exist")
        for option, value, least in (("--generations", self.generations, 1), ("--population", self.population, 4)):
            if value < least:
                raise UsageError(f"{option} {value}: expected at least {least}")
        if not 0.1 <= self.train <= 0.95:
            raise UsageError(f"--train {self.train:g}: expected a share from 0.1 to 0.95; the rest scores the laws")
        if self.delay is not None and not 0.0 <= self.delay <= 1.0:
            raise UsageError(f"--delay {self.delay:g}: expected 0 to 1 s")
        if not (math.isfinite(self.mass) and self.mass > 0.0):
            raise UsageError(f"--mass {self.mass:g}: expected a mass above 0 kg")


def _summary(found: Discovery) -> dict[str, object]:
    """Return the results as a dict for JSON: equations, delay, trims and errors on held-out data."""
    laws = {
        name: {
            "equation": law.text,
            "nodes": law.chosen.size,
            "front": [{"nodes": nodes, "error": error} for nodes, error in law.front],
        }
        for name, law in found.laws.items()
    }
    held = dict(found.held)
    return {
        "laws": laws,
        "as_published": held,
        "delay_s": found.delay,
        "trims": found.trims,
        "held_out_mean_squared_error": found.held_out,
    }


def _print(found: Discovery, out: Path) -> None:
    """Print the discovered equations, delay, trims and errors on held-out data."""
    from qrsim.studies.discover.flight import TRIM_UNITS

    for law in found.laws.values():
        print(f"\n{law.text}\n  {law.chosen.size} nodes; error by nodes:", end=" ")
        print(", ".join(f"{nodes}: {error:.3g}" for nodes, error in law.front))
    for name, why in found.held.items():
        print(f"\n{name}: flies as published: {why}")
    print(f"\ncommands of this log act {found.delay:.4g} s late")
    for name, trim in found.trims.items():
        print(f"\n{name.replace('_', ' ')} command of this log: {trim:+.4g} {TRIM_UNITS[name]} added")
    print(f"\nheld-out part, open loop: mean squared error\n  {'signal':<16} {'published':>11} {'discovered':>11}")
    for name in found.names:
        print(f"  {name:<16} {found.held_out['published'][name]:>11.4g} {found.held_out['discovered'][name]:>11.4g}")
    print(f"\n{out}, {out.with_suffix('.png')}")
