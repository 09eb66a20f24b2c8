"""The rotation rig: attitude and rates of the identified model under recorded stick commands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from qrsim.models.vehicles.quadrotor import THROTTLE_RAW_PER_UNIT, Quadrotor
from qrsim.simulation.openloop import simulate_open_loop
from qrsim.studies.validate.recorded import BATTERY_V, DT, Match, command_rows, read_table
from qrsim.studies.validate.report import Finding, Outcome, Part, reference_check, share_verdict

RECORDING = "rotation_rig.csv"
# A command that the recording leaves out.
THROTTLE_RAW = 0.615 * THROTTLE_RAW_PER_UNIT
NAMES = ("phi", "theta", "psi", "p", "q", "r")
WORDS = ("roll", "pitch", "yaw", "roll rate", "pitch rate", "yaw rate")
# docs/explanation/paper.md: held against recordings.
REFERENCE = ("6.563e-4", "8.355e-4", "1.755e-2", "2.478e-2", "1.872e-2", "2.867e-2")


def rotation_match(path: Path, precision: str = "float64") -> Match:
    """Simulate the rotation rig by recorded commands; return recorded and simulated angles [rad], rates [rad/s]."""
    rows = read_table(path, 11)
    pitch, roll, yaw, q, p, r = rows[:, 1:7].T
    constant = np.ones(len(rows))
    commands = command_rows(rows[:, 7], rows[:, 8], THROTTLE_RAW * constant, rows[:, 10], BATTERY_V * constant)
    recorded = np.stack([roll, pitch, yaw, p, q, r], axis=1)
    vehicle = Quadrotor()
    start = np.zeros(13)
    start[3:6], start[9:12] = recorded[0, :3], recorded[0, 3:]
    start[12] = vehicle.mass * vehicle.gravity
    states = simulate_open_loop(vehicle, commands, start, dt=DT, precision=precision)
    return Match(DT * np.arange(len(rows)), recorded, states[:, [3, 4, 5, 9, 10, 11]], NAMES)


def _run_part(paths: Mapping[str, Path], full: bool) -> Outcome:
    """Compare the rotation of a rig, at ``paths``, with the simulation; return the outcome for the report."""
    from qrsim.studies.validate.pictures import match_figure, picture

    match = rotation_match(paths[RECORDING])
    errors, explained = match.mean_square(), match.explained()
    units = ("rad²",) * 3 + ("(rad/s)²",) * 3
    checks = [
        reference_check(f"mean squared error of the {word}", errors[name], published, unit)
        for name, word, published, unit in zip(NAMES, WORDS, REFERENCE, units, strict=True)
    ]
    rms_deg = {name: float(np.degrees(np.sqrt(errors[name]))) for name in NAMES}
    end_deg = float(np.degrees(match.residual[-1, 2]))
    findings = [
        Finding(
            word,
            f"{100 * explained[name]:.1f} % of the variance explained; {rms_deg[name]:.1f} {unit} rms",
            share_verdict(explained[name]),
            _interpretation(name, end_deg),
        )
        for name, word, unit in zip(NAMES, WORDS, ("°",) * 3 + ("°/s",) * 3, strict=True)
    ]
    shown = Match(match.time, np.degrees(match.recorded[:, :3]), np.degrees(match.simulated[:, :3]), NAMES[:3])
    caption = (
        "Roll, pitch and yaw on the rotation rig: recorded, simulated from the recorded stick commands alone, and what"
        " is left between them."
    )
    return Outcome(
        method="A Pelican on a ball joint was turned about all axes by stick commands for 106 s, its own stabilisation"
        " running. The model gets the commands and the first row's angles and rates. Roll and pitch return to what is"
        " commanded, so an error dies out; yaw is an integral of the yaw rate, so its error stays.",
        reading=f"Roll and pitch are followed to {rms_deg['phi']:.1f}° and {rms_deg['theta']:.1f}° rms, and yaw, though"
        f" integrated over {DT * len(match.time):.0f} s without correction, to {rms_deg['psi']:.1f}° rms.",
        checks=checks,
        findings=findings,
        pictures=[picture(match_figure(shown, WORDS[:3], ("°",) * 3), caption)],
        numbers={
            "mean_squared_error": errors,
            "explained_share": explained,
            "rms_deg": rms_deg,
            "yaw_residual_at_end_deg": end_deg,
            "rows": len(match.time),
            "duration_s": DT * len(match.time),
        },
    )


def _interpretation(name: str, end_deg: float) -> str:
    """Return the sentence that interprets how well the simulation matches channel ``name``."""
    if name == "psi":
        return f"An integral without correction: it ends {abs(end_deg):.1f}° away and never leaves the record."
    if name in ("phi", "theta"):
        return "The second-order response with the platform's own stabilisation describes tilt well."
    return "Rates are noisier than angles in record and model alike, and their fast part is not described."


PART = Part(
    "rotation",
    "Rotation",
    "the rotation figure: recorded and simulated roll, pitch and yaw, over 100 s",
    (RECORDING,),
    _run_part,
)
