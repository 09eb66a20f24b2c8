"""The thrust rig: the identified thrust model under recorded throttle and battery voltage."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.integrate import heun
from qrsim.core.tree import cast
from qrsim.models.vehicles.quadrotor import THROTTLE_RAW_PER_UNIT, Quadrotor
from qrsim.studies.validate.recorded import DT, Match, read_table
from qrsim.studies.validate.report import Finding, Outcome, Part, reference_check, share_verdict

RECORDING = "thrust_rig.csv"
START_N = 15.4
# docs/explanation/paper.md: held against recordings.
REFERENCE_MEAN_SQUARE, REFERENCE_VARIANCE = "0.9817", "73.9"


def thrust_match(path: Path, precision: str = "float64") -> Match:
    """Simulate the rig's thrust [N] from recorded throttle and voltage; return recorded and simulated thrust."""
    rows = read_table(path, 4)
    with jax.enable_x64(precision == "float64"):
        vehicle = cast(Quadrotor(), precision)
        inputs = jnp.asarray(rows[:, [1, 3]], precision)

        def tick(thrust: jax.Array, row: jax.Array) -> tuple[jax.Array, jax.Array]:
            """Advance the thrust by one row of the recording; return it twice, as ``scan`` needs."""

            # The rig holds the body still, so that thrust is the whole state.
            def slope(now: jax.Array) -> tuple[jax.Array, jax.Array]:
                """Return the rate of the thrust [N/s], twice as ``heun`` needs."""
                rate = vehicle.thrust_rate(now, row[0] / THROTTLE_RAW_PER_UNIT, row[1], DT)
                return rate, rate

            thrust, _ = heun(slope, thrust, DT)
            return thrust, thrust

        thrust = np.asarray(jax.lax.scan(tick, jnp.asarray(START_N, precision), inputs)[1])
    return Match(DT * np.arange(len(rows)), rows[:, 2:3], thrust[:, None], ("thrust",))


def thrust_errors(path: Path, precision: str = "float64") -> dict[str, float]:
    """Return the mean squared error of the simulated thrust [N^2], and the recorded variance."""
    match = thrust_match(path, precision)
    return {
        "mean_squared_error": match.mean_square()["thrust"],
        "record_variance": float(np.var(match.recorded)),
    }


def _run_part(paths: Mapping[str, Path], full: bool) -> Outcome:
    """Compare the thrust of a rig, recorded at ``paths``, with the simulation; return the outcome for the report."""
    from qrsim.studies.validate.pictures import match_figure, picture

    match = thrust_match(paths[RECORDING])
    errors, explained = thrust_errors(paths[RECORDING]), match.explained()["thrust"]
    residual = match.residual[:, 0]
    rms, bias, largest = float(np.sqrt(np.mean(residual**2))), float(np.mean(residual)), float(np.max(np.abs(residual)))
    checks = [
        reference_check("mean squared error of the thrust", errors["mean_squared_error"], REFERENCE_MEAN_SQUARE, "N²"),
        reference_check("variance of the recorded thrust", errors["record_variance"], REFERENCE_VARIANCE, "N²"),
    ]
    finding = Finding(
        "thrust over the whole record",
        f"{100 * explained:.1f} % of the variance explained; residual {rms:.2f} N rms, mean {bias:+.3f} N",
        share_verdict(explained),
        f"Between the steps of the throttle little is left; at them it is up to {largest:.1f} N for some tenths of a"
        " second, where the record changes later or less abruptly than the model's limited rate.",
    )
    caption = (
        "Thrust on the test rig under steps of the throttle: recorded, simulated from the recorded throttle and battery"
        " voltage alone, and what is left between them."
    )
    return Outcome(
        method="A rig measured the thrust of a Pelican held still, 50 times a second, while its throttle was stepped."
        " The model gets the recorded throttle and battery voltage and one start value (15.4 N); nothing is fitted"
        " here, and nothing is fed back from the recording.",
        reading=f"The thrust model explains {100 * explained:.1f} % of the measured variance, to {rms:.2f} N rms of a"
        f" hover thrust of 16.5 N.",
        checks=checks,
        findings=[finding],
        pictures=[picture(match_figure(match, ("thrust",), ("N",)), caption)],
        numbers={
            **errors,
            "explained_share": explained,
            "residual_rms_n": rms,
            "residual_mean_n": bias,
            "residual_largest_n": largest,
            "rows": len(match.time),
            "duration_s": DT * len(match.time),
        },
    )


PART = Part(
    "thrust",
    "Thrust",
    "the thrust figure: recorded and simulated thrust on the rig and their residual, over 40 s",
    (RECORDING,),
    _run_part,
)
