"""Quantities to estimate: the vehicle's constants, and the nuisance parameters of each log."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

from qrsim.core.tree import field_info, record_of
from qrsim.errors import UsageError, did_you_mean
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.models.vehicles.separate_quadrotor import SeparateQuadrotor
from qrsim.studies.flight_logs import FlightLog

ANGULAR = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate")
VELOCITY = ("velocity_north", "velocity_east", "velocity_down")
CHANNELS = (*ANGULAR, *VELOCITY, "thrust")
TILT_COMMANDS = ("roll_command", "pitch_command", "yaw_rate_command")

ROLL, PITCH, YAW = ("kpq0", "kpq1", "kpq2"), ("kq0", "kq1", "kq2"), ("kr0", "kr1")
DRAG, THRUST = ("kuv", "kw"), ("cth0", "cth1", "cth2", "cvb0", "cvb1", "tau0", "tau1")
CONSTANTS = (*ROLL, *PITCH, *YAW, *DRAG, *THRUST, "mass")
# A constant may come to be this many times larger or smaller than where it starts, and keeps its sign.
WIDEST = 20.0
# These pass through zero: they may lie within so much [N, N/raw] of it.
THROUGH_ZERO = {"cth0": 50.0, "cth1": 0.05}


@dataclass(frozen=True)
class Nuisance:
    """A parameter of one log, estimated on its training part only.

    Attributes:
        unit, doc: what it is.
        scale: its usual size; the width of the weak prior that keeps it finite where a log says nothing of it.
        low, high: bounds.
    """

    unit: str
    doc: str
    scale: float
    low: float
    high: float


NUISANCES: dict[str, Nuisance] = {
    "delay": Nuisance("s", "by which commands act late", 0.02, 0.0, 1.0),
    "roll_trim": Nuisance("rad", "added to the roll command", 0.02, -0.3, 0.3),
    "pitch_trim": Nuisance("rad", "added to the pitch command", 0.02, -0.3, 0.3),
    "yaw_rate_trim": Nuisance("rad/s", "added to the yaw-rate command", 0.05, -0.5, 0.5),
    "wind_north": Nuisance("m/s", "constant wind, velocity of the air towards north", 3.0, -30.0, 30.0),
    "wind_east": Nuisance("m/s", "constant wind, velocity of the air towards east", 3.0, -30.0, 30.0),
    "wind_down": Nuisance("m/s", "constant wind, velocity of the air downwards", 0.1, -10.0, 10.0),
}


# Beside a measured thrust.
FOR_THRUST = ("throttle", "battery")


def channels_of(log: FlightLog) -> tuple[str, ...]:
    """Return the names of a log's measured signals that the fit uses.

    Raises:
        LogError: the log holds neither a rotation nor a thrust that can be simulated.
    """
    there = log.signals
    channels: tuple[str, ...] = ()
    if any(name in there for name in (*ANGULAR, *TILT_COMMANDS)) or "thrust" not in there:
        log.require((*ANGULAR, *TILT_COMMANDS), "the rotation of a vehicle")
        channels = ANGULAR
        if any(name in there for name in VELOCITY) and "throttle" in there:
            log.require(VELOCITY, "translation")
            channels += VELOCITY
    if "thrust" in there and not (channels and lacking(log)):
        log.require(FOR_THRUST, "thrust")
        channels += ("thrust",)
    return channels


def lacking(log: FlightLog) -> tuple[str, ...]:
    """Return the names of signals that a fit of thrust needs and the log lacks; () if it has all or no thrust."""
    return tuple(name for name in FOR_THRUST if "thrust" in log.signals and name not in log.signals)


def constants_in(channels: Iterable[str], separate: bool) -> tuple[str, ...]:
    """Return the model's constants that the measured signals depend on; ``separate``: pitch differs from roll."""
    channels = set(channels)
    found: tuple[str, ...] = ()
    if "roll" in channels:
        found += ROLL + (PITCH if separate else ()) + YAW
    if "velocity_down" in channels:
        found += DRAG
    if channels & {"velocity_down", "thrust"}:
        found += THRUST
    return found


def nuisances_in(channels: Iterable[str]) -> tuple[str, ...]:
    """Return the nuisance parameters (delay, trims, wind) that a log with these measured signals needs."""
    channels = set(channels)
    return (
        ("delay",)
        + (("roll_trim", "pitch_trim", "yaw_rate_trim") if "roll" in channels else ())
        + (("wind_north", "wind_east", "wind_down") if "velocity_north" in channels else ())
    )


def needed_for(constant: str) -> tuple[str, ...]:
    """Return the names of the signals required to estimate a constant."""
    if constant in (*ROLL, *PITCH, *YAW):
        return (*ANGULAR, *TILT_COMMANDS)
    if constant in (*DRAG, "mass"):
        return (*ANGULAR, *TILT_COMMANDS, *VELOCITY, "throttle")
    return ("throttle", "battery", "thrust")


def aspects_of(constant: str, separate: bool) -> tuple[str, ...]:
    """Return aspects of motion (such as "roll"), any of which excites a constant; ``separate``: pitch unlike roll."""
    if constant in PITCH:
        return ("pitch",)
    if constant in ROLL:
        return ("roll",) if separate else ("roll", "pitch")
    if constant in YAW:
        return ("yaw",)
    if constant in DRAG:
        return ("drag",) if constant == "kuv" else ("heave",)
    return ("heave",) if constant == "mass" else ("thrust", "heave")


def check_names(names: Iterable[str], separate: bool) -> None:
    """Raise UsageError for names that are no constants of the model; ``separate``: pitch differs from roll.

    Raises:
        UsageError: names the nearest one.
    """
    allowed = [name for name in CONSTANTS if separate or name not in PITCH]
    for name in names:
        if name in PITCH and not separate:
            raise UsageError(f"'{name}' is of pitch alone; add --separate")
        if name not in allowed:
            raise UsageError(f"no constant is called '{name}'{did_you_mean(name, allowed)}")


def bounds_of(name: str, start: float) -> tuple[float, float]:
    """Return the (low, high) bounds of a constant in the fit, which starts at ``start``."""
    if name in THROUGH_ZERO:
        return start - THROUGH_ZERO[name], start + THROUGH_ZERO[name]
    ends = sorted((start / WIDEST, start * WIDEST))
    return ends[0], ends[1]


def unit_of(name: str) -> str:
    """Return the unit of a constant or nuisance parameter."""
    if name in NUISANCES:
        return NUISANCES[name].unit
    return next(field_info(f).unit for f in dataclasses.fields(SeparateQuadrotor) if f.name == name)


def vehicle_of(values: dict[str, float], separate: bool) -> Quadrotor:
    """Return the published quadrotor with the given constants; ``separate``: pitch differs from roll."""
    cls = SeparateQuadrotor if separate else Quadrotor
    return record_of(cls, **values)
