"""``qrsim identify LOG --imu``: the noise of an inertial sensor from a log at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from qrsim.errors import UsageError
from qrsim.files import Content

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from qrsim.studies.identify.at_rest import Noise

PRESET = "icm42688p"


def identify_imu(log: Path, out: Path, begin: float, end: float, *, quiet: bool, as_json: bool) -> None:
    """Fit an IMU's noise to a log at rest, write the sensor and a figure, and print the result.

    Raises:
        UsageError: no such file, or nothing between ``begin`` and ``end`` [s].
        LogError: it holds no such readings, or stands still for too short a time.
    """
    from qrsim.runs.picture import save_picture
    from qrsim.scenarios.reading import dump_yaml
    from qrsim.studies.flight_logs.inertial import Readings, read_inertial
    from qrsim.studies.identify.at_rest import at_rest, noise_of, sensor_of
    from qrsim.studies.identify.result import write_text

    readings = read_inertial(log)
    first = max(round(begin / readings.period), 0)
    last = None if math.isinf(end) else round(end / readings.period)
    kept = {kind: values[first:last] for kind, values in readings.values.items()}
    if any(len(values) < 2 for values in kept.values()):
        raise UsageError(f"{log}: no readings from {begin:g} to {end:g} s")
    still, span = at_rest(Readings(readings.period, kept), str(log))
    found = {kind: noise_of(values, still.period) for kind, values in still.values.items()}
    sensor = sensor_of(found, PRESET)
    span = (span[0] + first * still.period, span[1] + first * still.period)
    head = (
        f"# Identified by 'qrsim identify --imu' from {log.name}, at rest from {span[0]:.0f} to {span[1]:.0f} s.\n"
        f"# What the log does not show is that of the preset. In a scenario: fleets.NAME.sensors.imu.\n"
    )
    write_text(out, head + dump_yaml({"imu": sensor}))
    picture = out.with_suffix(".png")
    save_picture(lambda: draw(found), picture)
    content = {
        "sensor": sensor,
        "file": str(out),
        "picture": str(picture),
        "at_rest_s": list(span),
        "rate_hz": 1.0 / still.period,
        "noise": {kind: _terms_content(kind, noise) for kind, noise in found.items()},
        "mean": {kind: noise.mean.tolist() for kind, noise in found.items()},
    }
    if as_json:
        import json

        print(json.dumps(content, indent=2))
    else:
        _print_terms(found, content, quiet=quiet)


def _terms_content(kind: str, noise: Noise) -> dict[str, dict[str, object]]:
    """Return the noise terms of "gyroscope" or "accelerometer" as a dict for JSON, with units."""
    from qrsim.studies.identify.at_rest import UNITS

    return {
        name: {"value": term.value, "low": term.low, "high": term.high, "seen": term.seen, "unit": unit}
        for (name, term), unit in zip(noise.terms.items(), UNITS[kind], strict=True)
    }


def _print_terms(found: Mapping[str, Noise], content: Content, *, quiet: bool) -> None:
    """Print an IMU's noise terms with intervals, the files written and, unless ``quiet``, the time at rest."""
    first, last = content["at_rest_s"]
    if not quiet:
        print(f"at rest from {first:.0f} to {last:.0f} s, {content['rate_hz']:.4g} readings a second")
    print(f"{'noise':<34} {'value':>11} {'95 % interval':>25}  unit")
    for kind in found:
        for name, term in content["noise"][kind].items():
            what = f"{kind}_{name}"
            if term["seen"]:
                print(f"{what:<34} {term['value']:>11.4g} {term['low']:>12.4g} {term['high']:>12.4g}  {term['unit']}")
            else:
                print(
                    f"{what:<34} not seen; at most {term['high']:.3g} {term['unit']}: that of the preset {PRESET} stays"
                )
    print(f"sensor: {content['file']}\npicture: {content['picture']}")


def draw(found: Mapping[str, Noise]) -> Figure:
    """Draw the Allan deviation of each axis of gyroscope and accelerometer, and of the fitted noise."""
    import numpy as np

    from qrsim.runs.picture import new_figure

    figure = new_figure(5.2 * len(found), 4.2)
    panels = np.atleast_1d(figure.subplots(1, len(found)))
    for axes, (kind, noise) in zip(panels, found.items(), strict=True):
        for axis, values in zip("xyz", noise.variance.T, strict=True):
            axes.loglog(noise.windows, np.sqrt(values), ".", label=axis)
        axes.loglog(noise.windows, np.sqrt(noise.fitted), "k-", lw=1.0, label="fit")
        axes.set_title(kind)
        axes.set_xlabel("averaging time [s]")
        axes.set_ylabel(f"Allan deviation [{'rad/s' if kind == 'gyroscope' else 'm/s²'}]")
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=9)
    return figure


def checked_imu(logs: list[Path], out: Path, default: Path, *, overwrite: bool) -> Path:
    """Return the sensor file to write; raises UsageError for several logs, a wrong suffix, or an existing file.

    Raises:
        UsageError: not one log, a name of another kind, or a file that exists.
    """
    if len(logs) != 1:
        raise UsageError(f"--imu: expected one LOG, found {len(logs)}")
    out = Path("my_imu.yaml") if out == default else out
    if out.suffix not in (".yaml", ".yml"):
        raise UsageError(f"--out {out}: expected a name that ends in .yaml")
    if out.exists() and not overwrite:
        raise UsageError(f"{out}: exists already; --overwrite replaces it")
    return out
