"""``qrsim identify``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from qrsim.apps import OPTIONAL_SECONDS, SECONDS, Repeated
from qrsim.errors import LogError, UsageError, did_you_mean

if TYPE_CHECKING:
    from qrsim.studies.identify.fit import Prior, Question
    from qrsim.studies.identify.result import Result

OUT = Path("my_vehicle.yaml")


@dataclass(frozen=True)
class Identify:
    """Find the constants of a vehicle from flight logs, and write it as a vehicle for scenarios.

    Logs: PX4 ULog, ArduPilot DataFlash .bin, bags of ROS 2, CSV with names and units ('roll [deg]'), the public
    recordings. The first part of each is fitted through the simulator's own equations; the rest is held out and scored
    open loop. A constant that the logs do not show, or that does not improve the prediction of the rest, keeps its
    start value, and this is reported. Logs that show no constant (on the ground, not commanded) are refused, and
    nothing is written.

    Example:
      qrsim identify flight.ulg --mass 1.9 -o my_vehicle.yaml
      qrsim identify one.bin two.bin --separate --mass 1.9:0.1 -o my_vehicle.yaml
      qrsim identify my_bag --namespace uav1 --mass 1.9 -o my_vehicle.yaml
      qrsim run hover_ideal --set "fleets.pelicans.vehicle={file: my_vehicle.yaml}"
      qrsim identify still.ulg --imu -o my_imu.yaml
    """

    logs: Annotated[tyro.conf.Positional[list[Path]], tyro.conf.arg(metavar="LOG [LOG ...]")]
    """Flight logs of the same vehicle."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o", "--output"], metavar="FILE")] = OUT
    """Vehicle to write; the report goes into a folder next to it, FILE without its ending plus _report."""
    vehicle: Literal["quadrotor"] = "quadrotor"
    """Form of the model."""
    separate: bool = False
    """Fit separate constants for pitch."""
    imu: bool = False
    """Find the noise of gyroscopes and accelerometers instead, from one log at rest, and write it as a sensor."""
    fit: Annotated[str | None, tyro.conf.arg(metavar="NAME[,NAME...]", help_behavior_hint="(default: all)")] = None
    """Only these constants; the others keep their start values."""
    start: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: published)")] = None
    """Vehicle written by this command, for the start values."""
    mass: Annotated[str | None, tyro.conf.arg(metavar="KG[:STD]", help_behavior_hint="(default: 1.68)")] = None
    """Take-off mass; with a standard deviation it is estimated about this value."""
    prior: Annotated[Repeated, tyro.conf.arg(metavar="NAME=VALUE:STD")] = field(default_factory=list)
    """Prior of a constant; can be given several times."""
    delay: Annotated[float | None, OPTIONAL_SECONDS, tyro.conf.arg(help_behavior_hint="(default: estimated)")] = None
    """Delay of the commands."""
    train: float = 0.6
    """Share of each log that is fitted; the rest is held out."""
    horizon: float = 5.0
    """Length of a window that is simulated open loop [s]."""
    loss: Literal["robust", "squares"] = "robust"
    """Loss of the residuals."""
    ignore: Annotated[str | None, tyro.conf.arg(metavar="SIGNAL[,SIGNAL...]", help_behavior_hint="(default: none)")] = (
        None
    )
    """Measured signals that are known to be wrong; they are still compared."""
    begin: Annotated[float, SECONDS, tyro.conf.arg(name="from")] = 0.0
    """Leave out what comes earlier in each log, such as standing on the ground."""
    end: Annotated[float, SECONDS, tyro.conf.arg(name="to", help_behavior_hint="(default: its end)")] = math.inf
    """Leave out what comes later in each log."""
    namespace: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: the only one)")] = None
    """Namespace of the vehicle's topics in a ROS 2 bag."""
    boot: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: most messages)")] = None
    """Number of the boot, from 1, in a DataFlash log with several."""
    overwrite: bool = False
    """Replace FILE if it exists."""
    quiet: bool = False
    """Print no progress."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> None:
        """Run ``qrsim identify``: read the logs, fit the parameters, and write and print the result."""
        if self.imu:
            from qrsim.studies.identify.imu_noise import checked_imu, identify_imu

            out = checked_imu(self.logs, self.out, OUT, overwrite=self.overwrite)
            if not self.begin < self.end:
                raise UsageError(f"--from {self.begin:g} is not before --to {self.end:g}")
            identify_imu(self.logs[0], out, self.begin, self.end, quiet=self.quiet, as_json=self.json)
            return
        self._check()
        from qrsim.studies.flight_logs import read_log
        from qrsim.studies.identify.constants import lacking
        from qrsim.studies.identify.identification import identify, part_of
        from qrsim.studies.identify.report import write_report
        from qrsim.studies.identify.result import write_text

        question = self._question()
        logs = [part_of(read_log(path, self.namespace, self.boot), self.begin, self.end) for path in self.logs]
        for log in logs:
            self._say(f"{log.source} ({log.kind})", *(f"  {note}" for note in log.notes))
            if missing := lacking(log):
                self._say(f"  thrust: left out, because there is no {' and no '.join(missing)}")
        try:
            found = identify(logs, question, self.horizon, self.train, self._say)
        except LogError as error:
            self._say(*error.details)
            raise
        write_text(self.out, found.yaml(self.out))
        folder = self.out.with_name(f"{self.out.stem}_report")
        write_report(found, folder)
        if self.json:
            import json

            print(json.dumps(found.to_json() | {"vehicle": str(self.out), "report": str(folder)}, indent=2))
        else:
            _print(found, self.out, folder)

    def _check(self) -> None:
        """Raise UsageError for options that are out of range or do not go together."""
        if not self.logs:
            raise UsageError("no LOG is named")
        if self.out.suffix not in (".yaml", ".yml"):
            raise UsageError(f"--out {self.out}: expected a name that ends in .yaml")
        if self.out.exists() and not self.overwrite:
            raise UsageError(f"{self.out}: exists already; --overwrite replaces it")
        if not 0.1 <= self.train <= 0.95:
            raise UsageError(f"--train {self.train:g}: expected a share from 0.1 to 0.95; the rest is held out")
        if not 0.2 <= self.horizon <= 1000.0:
            raise UsageError(f"--horizon {self.horizon:g}: expected 0.2 to 1000 s")
        if self.delay is not None and not 0.0 <= self.delay <= 1.0:
            raise UsageError(f"--delay {self.delay:g}: expected 0 to 1 s")
        if not self.begin < self.end:
            raise UsageError(f"--from {self.begin:g} is not before --to {self.end:g}")

    def _question(self) -> Question:
        """Return the fitting problem that the options describe: start values, priors, constants and logs."""
        from qrsim.scenarios.vehicle_checks import grams_hint
        from qrsim.studies.identify.constants import CHANNELS, CONSTANTS, PITCH, check_names
        from qrsim.studies.identify.fit import Question
        from qrsim.studies.identify.starting import starting_values

        start = starting_values(self.start, self.separate)
        priors: dict[str, Prior] = {}
        for text in self.prior:
            name, _, rest = text.partition("=")
            check_names([name], self.separate)
            priors[name] = _prior(f"--prior {text}", rest, "NAME=VALUE:STD")
        if self.mass is not None:
            value, colon, _ = self.mass.partition(":")
            if colon:
                priors["mass"] = _prior(f"--mass {self.mass}", self.mass, "KG:STD")
            start["mass"] = _number(f"--mass {self.mass}", value)
            if start["mass"] <= 0.0:
                raise UsageError(f"--mass {self.mass}: expected a mass above 0 kg")
            if hint := grams_hint(start["mass"]):
                raise UsageError(f"--mass {self.mass}: too heavy for a quadrotor{hint}")
        for name, prior in priors.items():
            start[name] = prior.mean
        names = tuple(name.strip() for name in self.fit.split(",")) if self.fit else ()
        check_names(names, self.separate)
        unused = [name for name in CONSTANTS if name in PITCH and not self.separate]
        start = {name: value for name, value in start.items() if name not in unused}
        ignored = tuple(name.strip() for name in self.ignore.split(",")) if self.ignore else ()
        for name in ignored:
            if name not in CHANNELS:
                raise UsageError(f"--ignore: no measured signal is called '{name}'{did_you_mean(name, CHANNELS)}")
        return Question(names, start, self.separate, priors, self.delay, self.loss == "robust", ignored)

    def _say(self, *lines: str) -> None:
        """Print lines on progress at once, unless --quiet or --json is given."""
        if not (self.quiet or self.json):
            for line in lines:
                print(line, flush=True)


def _number(option: str, text: str) -> float:
    """Convert an option's text to a finite number; raises UsageError for other texts."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option}: '{text}' is not a finite number")
    return value


def _prior(option: str, text: str, form: str) -> Prior:
    """Convert an option's text VALUE:STD to a prior; raises UsageError that shows the expected ``form``."""
    from qrsim.studies.identify.fit import Prior

    value, colon, std = text.partition(":")
    if not colon:
        raise UsageError(f"{option}: expected {form}")
    prior = Prior(_number(option, value), _number(option, std))
    if prior.std <= 0.0:
        raise UsageError(f"{option}: the standard deviation must be above 0")
    return prior


def _print(found: Result, out: Path, folder: Path) -> None:
    """Print the fitted parameters with intervals, verdicts and errors on held-out data."""
    print(f"\n{'constant':<10} {'value':>13} {'95 % interval':>29}   {'start':>13}  unit")
    for name, each in found.constants().items():
        print(
            f"{name:<10} {each['value']:>13.6g} {each['low']:>14.5g} {each['high']:>14.5g}   {each['start']:>13.6g}"
            f"  {each['unit']}"
        )
    values = found.answer.values
    for verdict, names in found.other_verdicts().items():
        listed = ", ".join(f"{name} {values[name]:.4g}" for name in names)
        print(f"{listed}: {verdict}")
    for words in found.effective_in_words():
        print(words)
    for i, (piece, scores) in enumerate(zip(found.pieces, found.held_out, strict=True)):
        _print_signals(found, i)
        print(f"\n{piece.log.source.name}, held-out {scores['rows']} rows, open loop: mean squared error")
        print(f"  {'signal':<16} {'start':>11} {'fitted':>11}   lower by")
        for name, after in scores["identified"].items():
            change = scores["lower_percent"].get(name, 0.0)
            print(f"  {name:<16} {scores['start'][name]:>11.4g} {after:>11.4g}   {change:6.1f} %")
        if scores.get("velocity_5_s"):
            five = scores["velocity_5_s"]
            print(
                f"  {'horizontal, 5 s':<16} {five['start']:>11.4g} {five['identified']:>11.4g}"
                f"   {five['lower_percent']:6.1f} %"
            )
    print(f"\n{found.wall_s:.1f} s, compiling included; {out}, {folder / 'report.md'}")


def _print_signals(found: Result, i: int) -> None:
    """Print, for log ``i``, how much each measured signal varies compared with its noise."""
    print(f"\n{found.pieces[i].log.source.name}, fitted part: how much its signals move")
    print(f"  {'signal':<17} {'std':>10} {'noise':>10} {'std/noise':>10}  unit")
    for name, each in found.channels(i).items():
        words = "" if each["moves"] else "  does not move"
        words = "  identified" if each.get("identified") else words
        print(
            f"  {name:<17} {each['std']:>10.3g} {each['noise']:>10.2g} {each['ratio']:>10.3g}  {each['unit']:<6}{words}"
        )
