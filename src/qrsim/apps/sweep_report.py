"""``qrsim sweep-report``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from qrsim.apps import Repeated
from qrsim.errors import RunError, UsageError, os_error_as


@dataclass(frozen=True)
class SweepReport:
    """Report the results of a sweep: tables, pictures, and the commands that fly the worst episodes again.

    Shows how a metric depends on each parameter, with confidence bands, and a map over two parameters. The point at
    which half of the episodes fail comes from a logistic fit. Sobol indices are added if the study was sampled for
    them. You can also report a running sweep: the report then covers the episodes flown so far.

    Example:
      qrsim sweep-report sweeps/station_keeping.zarr
      qrsim sweep-report sweeps/station_keeping.zarr --metric wind_max_m_s --out windy
    """

    store: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="STORE")]
    """Store of a sweep."""
    metric: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: the study's first)")] = (
        None
    )
    """Metric of the map, of the Sobol indices and of the worst episodes. Without it, the worst are
    those by the metric of the study's failure."""
    map: Annotated[
        Repeated,
        tyro.conf.arg(metavar="PARAMETER", help_behavior_hint="(default: the first two)"),
    ] = field(default_factory=list)
    """Parameter of the maps; give it twice."""
    out: Annotated[
        Path | None, tyro.conf.arg(aliases=["-o"], metavar="DIR", help_behavior_hint="(default: STORE-report)")
    ] = None
    """Folder for pictures and report.json."""
    format: Literal["png", "pdf", "svg"] = "png"
    """Format of the pictures."""
    json: bool = False
    """Print the tables as JSON."""

    def run(self) -> None:
        """Run ``qrsim sweep-report``: analyse a study's store, write the report, and print the tables."""
        from qrsim.extras import require

        require("sweep", "qrsim sweep-report")
        from qrsim.studies.sweep.report import find, print_report, to_json, write

        if not self.store.name:
            raise UsageError(f"{self.store}: it is no store of a sweep; 'qrsim sweep STUDY' writes one")
        folder = self.out or self.store.with_name(f"{self.store.name.removesuffix('.zarr')}-report")
        report = find(self.store, self.metric, self.map)
        with os_error_as(RunError, f"--out {folder}"):
            files = write(report, folder, self.format)
        if self.json:
            import json

            print(json.dumps({**to_json(report, folder), "files": [str(file) for file in files]}, indent=2))
            return
        print_report(report, folder)
        print(f"pictures: {', '.join(str(file) for file in files if file.suffix == f'.{self.format}')}")
