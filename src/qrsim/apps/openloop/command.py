"""``qrsim openloop``."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from qrsim.apps import SECONDS
from qrsim.errors import RunError, UsageError, did_you_mean

if TYPE_CHECKING:
    from qrsim.apps.openloop.command_file import CommandTable
    from qrsim.core.arrays import NumpyArray
    from qrsim.models.vehicles.quadrotor import Quadrotor

_INITIAL_FORMS = "6 (position, Euler angles), 12 (and body velocity, rates) or 13 (and thrust)"


@dataclass(frozen=True)
class OpenLoop:
    """Drive one vehicle with the commands of a CSV file: no world, no sensors, no noise.

    The file has a header and the columns pitch, roll, throttle, yaw and battery, in any order; row i holds during
    step i. Raw units are those of the autopilot; SI units are rad, rad, 0 to 1, rad/s (yaw or yaw_rate) and V.
    The output has one row per step: the 13 states after it and the mean specific force during it.

    Example:
      qrsim openloop commands.csv --units raw -o states.csv
      qrsim openloop commands.csv --units si --wind-body=1,-0.5,0.2 -o - | head
    """

    commands: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="COMMANDS.csv")]
    """File of commands."""
    units: Literal["raw", "si"]
    """Units of the commands."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"], metavar="STATES.csv")]
    """File of states to write; '-' is standard output."""
    vehicle: Annotated[str, tyro.conf.arg(metavar="NAME")] = "pelican"
    """Vehicle model."""
    wind_body: Annotated[str, tyro.conf.arg(metavar="U,V,W")] = "0,0,0"
    """Air velocity [m/s], constant in body axes."""
    initial: Annotated[
        str | None, tyro.conf.arg(metavar="NUMBERS", help_behavior_hint="(default: at rest, 10 m up, thrust m g)")
    ] = None
    """State before the first step, numbers separated by commas: position NED [m], Euler angles [rad]; or these and
    body velocity [m/s], rates [rad/s]; or these and thrust [N]. Missing numbers are zero, and the thrust is m g."""
    precision: Literal["float64", "float32"] = "float64"
    """Arithmetic."""
    time_step: Annotated[float, SECONDS] = 0.02
    """Length of a step."""
    clip: bool = False
    """Clip commands to their range (and print the number of rows) instead of refusing them."""
    overwrite: bool = False
    """Replace the output file if it exists."""

    def run(self) -> None:
        """Run ``qrsim openloop``: check everything, simulate the vehicle alone, and write its states."""
        from qrsim.apps.openloop.command_file import read_commands
        from qrsim.apps.openloop.state_file import STANDARD_OUTPUT, check_output, write_states

        check_output(self.output, self.overwrite, self.commands)
        if not (math.isfinite(self.time_step) and self.time_step > 0.0):
            raise UsageError(f"--time-step {self.time_step}: expected a positive number of seconds")
        wind = _numbers("--wind-body", self.wind_body, (3,), "3 (u, v, w)")
        initial = None
        if self.initial is not None:
            initial = _numbers("--initial", self.initial, (6, 12, 13), _INITIAL_FORMS)
        table = read_commands(self.commands, self.units)
        if table.ignored:
            _note(f"{self.commands}: columns not used: {', '.join(table.ignored)}")
        states = self._simulate(table, wind, initial)
        write_states(states, self.output)
        if self.output != STANDARD_OUTPUT:
            print(f"{self.output}: {len(states)} steps, {len(states) * self.time_step:g} s")

    def _simulate(self, table: CommandTable, wind: list[float], initial: list[float] | None) -> NumpyArray:
        """Return the states and specific forces (T, 16) that a table of commands gives in a constant wind [m/s]."""
        import numpy as np

        from qrsim.apps.openloop.units import si_within_limits
        from qrsim.simulation.openloop import simulate_open_loop

        vehicle = _vehicle(self.vehicle)
        commands, clipped = si_within_limits(table, self.units, self.clip)
        if clipped.any():
            first = table.lines[clipped.argmax()]
            _note(f"{self.commands}: {clipped.sum()} of {len(clipped)} rows clipped, the first on line {first}")
        states = simulate_open_loop(
            vehicle,
            commands,
            _initial_state(vehicle, initial),
            wind_body=(wind[0], wind[1], wind[2]),
            dt=self.time_step,
            precision=self.precision,
        )
        finite = np.isfinite(states).all(axis=1)
        if not finite.all():
            row = int(finite.argmin())
            raise RunError(
                f"the state is not finite from step {row + 1} on (line {table.lines[row]} of {self.commands});"
                " nothing was written. A pitch of 90 degrees does this, and so does a --time-step that is too long"
            )
        return states


def known_vehicles() -> dict[str, type[Quadrotor]]:
    """Return name -> class of the vehicle models that have the identified quadrotor's states and commands."""
    from qrsim.models.vehicles.quadrotor import Quadrotor
    from qrsim.scenarios.catalogue import VEHICLES

    return {name: kind for name, kind in VEHICLES.items() if issubclass(kind, Quadrotor)}


def _vehicle(name: str) -> Quadrotor:
    """Return the vehicle model of --vehicle; raises UsageError for an unknown name."""
    vehicles = known_vehicles()
    if name not in vehicles:
        raise UsageError(f"--vehicle {name}: no such vehicle{did_you_mean(name, vehicles)}")
    return vehicles[name]()


def _initial_state(vehicle: Quadrotor, initial: list[float] | None) -> NumpyArray:
    """Return the initial state (13,) from the values of --initial; missing ones are 0, and the thrust equals the
    weight."""
    from qrsim.simulation.openloop import hover_state

    state = hover_state(vehicle)
    if initial is not None:
        state[: len(initial)] = initial
    return state


def _numbers(option: str, text: str, counts: tuple[int, ...], expected: str) -> list[float]:
    """Parse an option's comma-separated numbers; raises UsageError unless their count is in ``counts`` (``expected``:
    in words)."""
    fields = text.split(",")
    numbers = []
    for place, field in enumerate(fields, start=1):
        try:
            number = float(field)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise UsageError(f"{option}={text}: number {place}, {field.strip()!r}, is not a finite number")
        numbers.append(number)
    if len(numbers) not in counts:
        raise UsageError(f"{option}={text}: {len(numbers)} numbers; expected {expected}, separated by commas")
    return numbers


def _note(text: str) -> None:
    """Print a note for the user on standard error."""
    print(f"note: {text}", file=sys.stderr)
