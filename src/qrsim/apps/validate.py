"""``qrsim validate``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import Repeated
from qrsim.errors import RunError, os_error_as
from qrsim.extras import require

if TYPE_CHECKING:
    from qrsim.studies.validate.parts import Result
    from qrsim.studies.validate.report import Part

PAGE, PRINTED, NUMBERS, FIGURES = "validation.html", "validation.pdf", "validation.json", "figures"


@dataclass(frozen=True)
class Validate:
    """Compare every model with recordings, closed forms and an independent simulator, and write a report.

    The validation figures of the original simulator, each with its number, its bound and a verdict: thrust, rotation,
    translation, turbulence, wind_field, gnss, receivers, drifts, imu. Writes a self-contained HTML page, a PDF of the
    same with vector graphics, each picture in figures/, and a JSON of every number. Parts that lack their recordings
    are skipped, and named; 'qrsim data fetch' gets the recordings.

    Exit code 0: every check passed; 1: one did not. The fit of a model to a recording is reported, but does not count
    as a failure.

    Example:
      qrsim validate
      qrsim validate --only thrust --only rotation --out reports/today
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: validation)")] = Path("validation")
    """Folder for the report."""
    only: Annotated[Repeated, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: all)")] = field(
        default_factory=list
    )
    """Run only this part; can be given several times."""
    json: bool = False
    """Print the JSON of every number instead of the summary."""

    def run(self) -> int:
        """Run ``qrsim validate``: compare the models with recordings, write the report, print a summary; return the
        exit code."""
        from qrsim.engine.settings import use_compilation_cache
        from qrsim.studies.validate.parts import choose, find_recordings, run_parts

        parts = choose(self.only)
        require("validate", "qrsim validate")
        found = find_recordings(parts)
        _check_folder(self.out)
        use_compilation_cache()
        with _progress(parts) as done:
            results = run_parts(parts, found, done=done)
        report = to_json(results)
        self._write(results, report)
        self._print(results, report)
        return 0 if report["passed"] else 1

    def _write(self, results: list[Result], report: Mapping[str, object]) -> None:
        """Write the report as web page, PDF, JSON and figures."""
        from qrsim.files.atomic import write_atomically
        from qrsim.studies.validate.page import write_page
        from qrsim.studies.validate.pdf import figures, write_pdf

        texts = {PAGE: write_page(results, report), NUMBERS: _dump(report)}
        files = {name: text.encode("utf-8") for name, text in texts.items()}
        files |= {PRINTED: write_pdf(results, report)}
        files |= {f"{FIGURES}/{name}": content for name, content in figures(results).items()}
        for name, content in files.items():
            path = self.out / name
            with os_error_as(RunError, f"cannot write {path}"):
                path.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(path, content)

    def _print(self, results: list[Result], report: Mapping[str, object]) -> None:
        """Print the outcome of each part and where the report is, or the report as JSON."""
        if self.json:
            print(_dump(report), end="")
            return
        for result in results:
            _print_part(result)
        print(f"report:  {self.out / PAGE}, {self.out / PRINTED}")
        print(f"figures: {self.out / FIGURES}/\nnumbers: {self.out / NUMBERS}")


def to_json(results: list[Result]) -> dict[str, object]:
    """Return the results as a dict for JSON, without pictures."""
    import datetime
    import platform
    from importlib.metadata import version

    from qrsim.files.recordings import RECORDINGS

    used = dict.fromkeys(name for result in results if result.outcome for name in result.part.recordings)
    return {
        "qrsim": version("qrsim"),
        "jax": version("jax"),
        "platform": platform.platform(),
        "made": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "passed": all(result.outcome.passed for result in results if result.outcome),
        "recordings": {name: RECORDINGS[name].sha256 for name in used},
        "parts": {result.part.name: result.to_json() for result in results},
    }


def _dump(report: Mapping[str, object]) -> str:
    """Return a report as indented JSON with a line end."""
    import json

    return json.dumps(report, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _print_part(result: Result) -> None:
    """Print the outcome of one part of the validation: its checks, those that failed, findings and what was skipped."""
    outcome = result.outcome
    if outcome is None:
        print(f"skipped  {result.part.title}: {result.skipped}\n")
        return
    good = sum(check.passed for check in outcome.checks)
    print(f"{'pass' if outcome.passed else 'FAIL':<8} {result.part.title}: {good} of {len(outcome.checks)} checks")
    print(f"         {outcome.reading}")
    for check in outcome.checks:
        if not check.passed:
            told = f"{check.value:.6g} {check.unit}".rstrip()
            print(f"         FAIL {check.name}: {told}, expected {check.expected:.6g} ± {check.tolerance:.2g}")
    for finding in outcome.findings:
        if finding.verdict != "to note":
            print(f"         {finding.verdict}: {finding.name}: {finding.number}")
    for words in outcome.skipped:
        print(f"         skipped: {words}")
    print()


def _check_folder(folder: Path) -> None:
    """Create the folder and check that it can be written, before anything is computed.

    Raises:
        RunError: this is not possible.
    """
    import tempfile

    with os_error_as(RunError, f"--out {folder}: cannot write there"):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".qrsim-"):
            pass


@contextmanager
def _progress(parts: list[Part]) -> Iterator[Callable[[Part], None] | None]:
    """Show which part of the validation runs in the context, on a terminal only; yield the function that marks a part
    as done, or None."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<12}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    names = [part.name for part in parts]
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(names[0], total=len(parts))

        def done(part: Part) -> None:
            """Mark a part as done in the progress bar and show the next one."""
            bar.advance(task)
            bar.update(task, description=names[min(names.index(part.name) + 1, len(names) - 1)])

        yield done
