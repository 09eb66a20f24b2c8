"""``qrsim export``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from qrsim.errors import UsageError
from qrsim.extras import require

if TYPE_CHECKING:
    from qrsim.runs import Run
    from qrsim.runs.export.output import Written

TRACK_PERIOD_S = 0.2
# Ends of names that are not those of the format.
ENDINGS = {"rerun": "rrd"}
# Formats of learned policies; all others are of runs.
OF_POLICIES = ("c", "onnx")


@dataclass(frozen=True)
class Export:
    """Write a recorded run as csv, geojson, gpx, kml, mcap, rerun or rosbag2; or a learned policy as C or ONNX.

    Format csv has one table per stream, every column with its unit, in full precision. Formats geojson, gpx and kml
    have the true and the GNSS-reported track of every vehicle and the events, on WGS-84. Format mcap has poses, fixes,
    sensors, commands, wind, scene and events for Foxglove, east-north-up, and a layout for it in NAME.layout.json.
    Format rerun has the same for the viewer of rerun (.rrd), and every number of the log as a series.
    Format rosbag2 has the topics of 'qrsim ros2', as ROS 2 records them.

    Formats c and onnx are for a policy of 'qrsim train': a function without dependencies, or a model for any runtime of
    ONNX, from an observation to an action.

    Heights are above the WGS-84 ellipsoid. Those of gpx are above mean sea level (EGM96), and those of kml above the
    ground unless --heights is given. A run that is in progress, was interrupted or was killed is exported up to its
    last flush; damaged parts are left out with a warning.

    Example:
      qrsim export runs/first --format csv
      qrsim export runs/first --format csv --stream truth --every 10 --out truth.csv
      qrsim export runs/first --format kml --out first.kml
      qrsim export runs/goto/policy.npz --format c --out policy.c
    """

    run_folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Run folder; for c and onnx a policy.npz."""
    format: Literal["csv", "geojson", "gpx", "kml", "mcap", "rerun", "rosbag2", "c", "onnx"]
    """File format."""
    out: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="PATH",
            help_behavior_hint="(default: RUN/export/NAME.FORMAT, csv: RUN/export, c and onnx: next to POLICY)",
        ),
    ] = None
    """File to write; for csv of all streams, the folder of its files; for rosbag2 the folder of the bag."""
    stream: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: all)")] = None
    """The only stream to write, csv only."""
    every: Annotated[
        int | None,
        tyro.conf.arg(
            metavar="N", help_behavior_hint="(default: 1 for csv, mcap, rerun and rosbag2, 5 Hz for the others)"
        ),
    ] = None
    """Keep every Nth tick; all events are kept."""
    heights: Literal["ground", "sea", "ellipsoid"] = "ground"
    """Heights of kml: above the ground, above mean sea level (EGM96), or above the WGS-84 ellipsoid."""
    distro: Annotated[str, tyro.conf.arg(metavar="NAME")] = "jazzy"
    """ROS 2 distribution that will read the bag: humble, iron, jazzy, kilted or lyrical."""
    code: bool = False
    """Load the Python files and modules that the recorded scenario names; only if you trust its author."""
    force: bool = False
    """Overwrite files that exist."""
    json: bool = False
    """Print what was written as JSON."""

    def run(self) -> None:
        """Run ``qrsim export``: check the options, write the files, and print their paths."""
        from qrsim.runs import open_run
        from qrsim.runs.layout import LARGEST_EVERY
        from qrsim.tasks.learned import is_policy_file

        if self.every is not None and not 1 <= self.every <= LARGEST_EVERY:
            raise UsageError(f"--every {self.every}: expected an integer from 1 to 2**31 - 1")
        if self.heights != "ground" and self.format != "kml":
            own = "mean sea level" if self.format == "gpx" else "the WGS-84 ellipsoid"
            raise UsageError(f"--heights {self.heights}: only kml has this choice; {self.format} has those above {own}")
        if self.stream is not None and self.format != "csv":
            raise UsageError(f"--stream chooses among the tables of csv; {self.format} has no such choice")
        if self.distro != "jazzy" and self.format != "rosbag2":
            raise UsageError(f"--distro {self.distro}: only rosbag2 is of a distribution of ROS 2, not {self.format}")
        if is_policy_file(self.run_folder) or self.format in OF_POLICIES:
            self._write_policy()
            return
        recorded = open_run(self.run_folder, skip_damaged=True, code=self.code)
        if recorded.unfinished:
            print(recorded.unfinished, file=sys.stderr)
        every = self.every or self._usual_every(recorded)
        if self.format == "csv":
            written = self._write_tables(recorded, every)
        else:
            written = [(self._write_bag if self.format == "rosbag2" else self._write_file)(recorded, every)]
        self._report(written, every)

    def _write_policy(self) -> None:
        """Write the learned policy of a file as C source or an ONNX model.

        Raises:
            UsageError: another format, options of runs, or no policy.
            MissingExtraError: the format needs a package that is not installed.
        """
        from qrsim.runs.export.output import Written, check_target, replacing
        from qrsim.tasks.learned import read_policy
        from qrsim.tasks.learned_c import c_source
        from qrsim.tasks.learned_onnx import onnx_model

        if self.format not in OF_POLICIES:
            raise UsageError(f"{self.run_folder} is a policy, not a run; allowed: --format {' or '.join(OF_POLICIES)}")
        if self.run_folder.is_dir():
            wanted = f"--format {self.format} needs a policy file, such as policy.npz"
            raise UsageError(f"{self.run_folder} is a folder; {wanted}")
        if self.every is not None or self.stream is not None:
            raise UsageError(f"{'--stream' if self.every is None else '--every'}: a policy has no ticks and no streams")
        policy = read_policy(self.run_folder)
        target = self.out or self.run_folder.with_suffix(f".{self.format}")
        check_target(target, self.force)
        content = c_source(policy).encode() if self.format == "c" else onnx_model(policy)
        with replacing(target) as file:
            file.write(content)
        self._report([Written(target, {"inputs": policy.view.inputs, "layers": len(policy.layers)})], 1)

    def _usual_every(self, recorded: Run) -> int:
        """Return the default of --every (keep every Nth tick): 1 for logs, larger for tracks."""
        if self.format in ("csv", "mcap", "rerun", "rosbag2"):
            return 1
        return max(1, round(TRACK_PERIOD_S / recorded.info.time_step))

    def _write_tables(self, recorded: Run, every: int) -> list[Written]:
        """Write a CSV file for each stream of the run, or for the chosen one."""
        from qrsim.runs.export.csv_files import write_stream
        from qrsim.runs.export.output import check_target, readable_streams

        streams = readable_streams(recorded, self.stream)
        if self.stream is not None and self.out is not None:
            targets = [self.out]
        else:
            folder = self.out or self.run_folder / "export"
            if folder.is_file():
                raise UsageError(f"--out {folder} is a file; csv of all streams needs a folder, or give --stream")
            targets = [folder / f"{stream}.csv" for stream in streams]
        for target in targets:
            check_target(target, self.force)
        return [write_stream(recorded, *pair, every) for pair in zip(streams, targets, strict=True)]

    def _write_bag(self, recorded: Run, every: int) -> Written:
        """Write a ROS 2 bag; an existing folder is overwritten with --force, and only if it is a bag."""
        require("ros2", "a bag of ROS 2")
        from qrsim.links.ros2 import bag
        from qrsim.runs.export.output import Written

        folder = self.out or self.run_folder / "export" / f"{self.run_folder.resolve().name}.rosbag2"
        if folder.exists() and not self.force:
            raise UsageError(f"{folder} exists; choose another --out, or --force to overwrite it")
        if folder.exists() and not (folder / bag.METADATA).is_file():
            raise UsageError(f"{folder} is no bag, and is not overwritten; choose another --out")
        return Written(folder, bag.write(recorded, folder, every, self.distro))

    def _write_file(self, recorded: Run, every: int) -> Written:
        """Write one file in the chosen format: MCAP, rerun, KML, GPX or GeoJSON."""
        from qrsim.runs.export import geojson, gpx, kml
        from qrsim.runs.export.output import check_target
        from qrsim.runs.export.place import place_of
        from qrsim.runs.export.tracks import read_tracks

        target = (
            self.out
            or self.run_folder / "export" / f"{self.run_folder.resolve().name}.{ENDINGS.get(self.format, self.format)}"
        )
        check_target(target, self.force)
        place = place_of(recorded)
        if self.format == "rerun":
            require("rerun", "a file of rerun")
            from qrsim.runs.export import rerun_file

            return rerun_file.write(recorded, place, target, every)
        if self.format != "geojson":
            require(
                "export", f"a file of {self.format}", {"mcap": "mcap", "kml": "simplekml", "gpx": "gpxpy"}[self.format]
            )
        if self.format == "mcap":
            from qrsim.runs.export import mcap_file
            from qrsim.runs.export.foxglove_layout import layout_path, write_layout

            layout = layout_path(target)
            check_target(layout, self.force)
            written = mcap_file.write(recorded, place, target, every)
            write_layout(recorded, layout)
            return written
        tracks = read_tracks(recorded, place, every)
        if self.format == "kml":
            return kml.write(tracks, target, self.heights)
        return (geojson.write if self.format == "geojson" else gpx.write)(tracks, target)

    def _report(self, written: list[Written], every: int) -> None:
        """Print which files were written and what they contain, as text or JSON."""
        import json

        if self.json:
            files = [{"path": str(item.path), **item.counts} for item in written]
            result = {"run": str(self.run_folder), "format": self.format, "every": every, "files": files}
            print(json.dumps(result, indent=2))
            return
        for item in written:
            print(f"{item.path}: {', '.join(f'{count} {what}' for what, count in item.counts.items())}")
