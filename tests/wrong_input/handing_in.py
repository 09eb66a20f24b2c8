"""What a user can hand in, and what is done with it: each kind has its seeds and a target that a mutation goes to."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import warnings
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from tests.wrong_input.logs import csv_log, dataflash, inertial_ulog, rig_log, sp3, ulog
from tests.wrong_input.maps import (
    GEOJSON,
    GEOJSON_ROUTE,
    GPX_ROUTE,
    HEIGHTS,
    KML,
    KML_ROUTE,
    PLAN,
    SCAN,
    WAYPOINTS,
)
from tests.wrong_input.mutating import Rng, mutated, number, scaled
from tests.wrong_input.states import attempt, mutants, saved_state, simulation_of

from qrsim.errors import QrsimError

BUG = "this is a bug in qrsim"


class BugError(Exception):
    """The command line met an error that nobody had thought of."""


def command(*words: str) -> int:
    """Run a command of ``qrsim`` in this process; raises BugError where it would print a traceback."""
    from qrsim.cli import main

    said, complaints = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complaints):
        code = main([str(word) for word in words])
    if BUG in complaints.getvalue():
        raise BugError(complaints.getvalue())
    if code not in (0, 1, 2):
        raise BugError(f"exit code {code}")
    return code


def refused(code: int) -> None:
    """Raise a QrsimError where a command has refused what it was given."""
    if code:
        raise QrsimError(f"exit code {code}")


@dataclass
class Workshop:
    """Seeds in a folder of this process, and where their mutations go.

    Attributes:
        folder: for files; it is emptied by whoever made it.
    """

    folder: Path

    def write(self, name: str, data: bytes) -> Path:
        """Write a file that takes part in one case."""
        path = self.folder / name
        path.write_bytes(data.replace(b"PIPE", str(self.pipe).encode()))
        return path

    @cached_property
    def pipe(self) -> Path:
        """A named pipe that nobody writes to."""
        path = self.folder / "pipe.yaml"
        os.mkfifo(path)
        return path

    @cached_property
    def scenarios(self) -> list[tuple[str, bytes]]:
        """Every scenario that comes with qrsim, as written and with all defaults."""
        from importlib import resources

        from qrsim.scenarios.scenario import built_in_names, load_scenario

        folder = resources.files("qrsim.scenarios")
        found = []
        for name in built_in_names():
            found.append((name, folder.joinpath(*f"{name}.yaml".split("/")).read_bytes()))
            found.append((f"{name} in full", load_scenario(name).to_yaml().encode()))
        return found

    @cached_property
    def studies(self) -> list[tuple[str, bytes]]:
        """Every study that comes with qrsim."""
        from importlib import resources

        folder = resources.files("qrsim.studies.sweep")
        return [(item.name, item.read_bytes()) for item in sorted(folder.iterdir(), key=str) if ".yaml" in item.name]

    @cached_property
    def run_folder(self) -> Path:
        """A short run of two vehicles."""
        return self._flown("run", 0.2)

    def _flown(self, name: str, duration: float) -> Path:
        folder = self.folder / name
        content = {"name": name, "duration": duration, "fleets": {"a": FLEET}}
        path = self.write(f"{name}.yaml", json.dumps(content).encode())
        assert command("run", str(path), "--out", str(folder), "--no-figure") == 0
        return folder

    @cached_property
    def saved(self) -> tuple[bytes, Any]:
        """A saved state, and the simulation that it is of."""
        return saved_state(), simulation_of("outdoor_patrol")

    @cached_property
    def logs(self) -> list[tuple[str, bytes, bool]]:
        """Logs in the formats that are read: name, content, whether it is binary."""
        return [
            ("log.csv", csv_log(), False),
            ("rig.csv", rig_log(), False),
            ("log.ulg", ulog(), True),
            ("rest.ulg", inertial_ulog(), True),
            ("log.bin", dataflash(), True),
        ]

    @cached_property
    def bag(self) -> Path:
        """A run of five seconds as a bag of ROS 2: a description and a file in MCAP."""
        folder, run = self.folder / "bag", self._flown("five", 5.0)
        assert command("export", str(run), "--format", "rosbag2", "--every", "10", "--out", str(folder)) == 0
        return folder


FLEET: dict[str, Any] = {
    "controller": {"type": "waypoint", "feed": "truth"},
    "sensors": {"gnss": {"type": "gnss_receiver"}, "barometer": {"type": "barometer"}},
    "vehicles": [
        {"position_ned": [0.0, 0.0, -20.0]},
        {"position_ned": [9.0, 0.0, -20.0], "waypoints_ned": [[9.0, 9.0, -20.0]]},
    ],
}
OVERRIDES = (
    "world.wind.speed_20ft=7", "world.turbulence=still", "fleets.pelicans.controller.type=waypoint", "duration=10",
    "fleets.pelicans.vehicle.mass=2", "fleets.pelicans.vehicles.0.position_ned=[1, 2, -3]", "time_step=0.01",
    "fleets.pelicans.sensors.gnss={type: ideal_gnss}", "fleets.pelicans.guidance.repeat=true",
    "start_time=2026-06-21T10:00:00Z", "fleets.pelicans.limits.rate=[1, 2, 3, 4, 5]",
)  # fmt: skip
_SCAN_PLAN = {**PLAN, "mission": {**PLAN["mission"], "hoverSpeed": 4, "items": [*PLAN["mission"]["items"][:2], SCAN]}}
# Routes in every format, by the name of the file.
ROUTES = (
    ("field.waypoints", WAYPOINTS.encode()), ("way.kml", KML_ROUTE.encode()), ("way.kmz", KML_ROUTE.encode()),
    ("way.gpx", GPX_ROUTE.encode()), ("way.geojson", json.dumps(GEOJSON_ROUTE, indent=1).encode()),
    ("scan.plan", json.dumps(_SCAN_PLAN, indent=1).encode()),
)  # fmt: skip
# Of few structures, so that few programs are compiled.
FLOWN, FLOWN_TICKS = ("outdoor_patrol", "keep_spot", "hover"), 5


def _scenario(shop: Workshop, rng: Rng) -> None:
    _, data = shop.scenarios[int(rng.integers(len(shop.scenarios)))]
    path = shop.write("scenario.yaml", mutated(rng, data))
    if rng.random() < 0.1:
        refused(command("show", str(path)))
        return
    from qrsim.scenarios.scenario import load_scenario

    load_scenario(path).world("float32")


def _flight(shop: Workshop, rng: Rng) -> None:
    """A scenario whose numbers are others; where it is taken, it also flies."""
    import qrsim
    from qrsim.scenarios.scenario import load_scenario

    text = load_scenario(FLOWN[int(rng.integers(len(FLOWN)))]).to_yaml()
    for _ in range(int(rng.integers(1, 4))):
        text = (scaled, scaled, number)[int(rng.integers(3))](rng, text)
    simulation = qrsim.load(shop.write("flown.yaml", text.encode()))
    simulation.reset()
    simulation.step(ticks=FLOWN_TICKS)


def _override(shop: Workshop, rng: Rng) -> None:
    from qrsim.scenarios.scenario import load_scenario

    texts = [OVERRIDES[int(i)] for i in rng.integers(len(OVERRIDES), size=int(rng.integers(1, 3)))]
    given = [mutated(rng, text.encode()).decode("utf-8", "replace").replace("PIPE", str(shop.pipe)) for text in texts]
    load_scenario("outdoor_patrol", given).world("float32")


def _vehicle(shop: Workshop, rng: Rng) -> None:
    from qrsim.scenarios.scenario import load_scenario

    laws = "tilt_law: 179.8*(command - angle) - 24.35*rate, yaw_law: 5.1*(command - rate)"
    texts = ("vehicle: {type: pelican, mass: 1.7, kpq1: 170.0}", f"vehicle: {{type: expression, {laws}}}")
    shop.write("vehicle.yaml", mutated(rng, texts[int(rng.integers(2))].encode()))
    vehicle = {"file": str(shop.folder / "vehicle.yaml")}
    load_scenario({"name": "x", "fleets": {"a": {**FLEET, "vehicle": vehicle}}}).world("float32")


def _plan(shop: Workshop, rng: Rng) -> None:
    from qrsim.scenarios.scenario import load_scenario

    path = shop.write("route.plan", mutated(rng, json.dumps(PLAN, indent=1).encode()))
    vehicles = [{"plan": {"file": str(path)}}]
    area = {"type": "fence", "file": str(path), "z_min": -200.0, "z_max": 0.0}
    world = {"area": area} if rng.random() < 0.5 else {}
    load_scenario({"name": "x", "world": world, "fleets": {"a": {**FLEET, "vehicles": vehicles}}}).world("float32")


def _route(shop: Workshop, rng: Rng) -> None:
    """A plan of another format, or with a scan, flown as a mission."""
    from qrsim.scenarios.scenario import load_scenario

    name, data = ROUTES[int(rng.integers(len(ROUTES)))]
    content = mutated(rng, data)
    if name.endswith(".kmz"):
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("doc.kml", content)
        content = packed.getvalue() if rng.random() < 0.5 else mutated(rng, packed.getvalue(), binary=True)
    spec = {"file": str(shop.write(name, content))}
    mission = {"controller": {"type": "cascade", "feed": "truth"}, "guidance": {"type": "mission"}}
    fleet = {**FLEET, **(mission if rng.random() < 0.5 else {}), "vehicles": [{"plan": spec}]}
    load_scenario({"name": "x", "site": {"height": 100.0}, "fleets": {"a": fleet}}).world("float32")


def _kml(shop: Workshop, rng: Rng) -> None:
    from qrsim.scenarios.scenario import load_scenario

    path = shop.write("fence.kml", mutated(rng, KML.encode()))
    area = {"type": "fence", "file": str(path), "z_min": -200.0, "z_max": 0.0}
    load_scenario({"name": "x", "world": {"area": area}, "fleets": {"a": FLEET}}).world("float32")


def _study(shop: Workshop, rng: Rng) -> None:
    from qrsim.studies.sweep.prepare import plan_of
    from qrsim.studies.sweep.study import load_study

    _, data = shop.studies[int(rng.integers(len(shop.studies)))]
    plan = plan_of(load_study(str(shop.write("study.yaml", mutated(rng, data)))))
    plan.batch(0)
    plan.batch(plan.batches - 1)


def _state(shop: Workshop, rng: Rng) -> None:
    saved, simulation = shop.saved
    _, given = list(mutants(saved, int(rng.integers(2**31)), 2))[int(rng.integers(2))]
    try:
        outcome = attempt(simulation, given)
    finally:
        simulation.load(saved)
    refused(outcome == "refused")


def _run(shop: Workshop, rng: Rng) -> None:
    files = sorted(path for path in shop.run_folder.rglob("*") if path.is_file())
    chosen = files[int(rng.integers(len(files)))]
    copy = shop.folder / "copy"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(shop.run_folder, copy)
    path = copy / chosen.relative_to(shop.run_folder)
    if rng.random() < 0.05:
        path.unlink()
        if rng.random() < 0.5:
            os.mkfifo(path)
    else:
        path.write_bytes(mutated(rng, chosen.read_bytes(), binary=chosen.suffix == ".parquet"))
    what = int(rng.integers(6))
    if what == 0:
        refused(min(command("compare", str(copy), str(shop.run_folder)), 2) // 2)
    elif what == 1:
        formats = ("csv", "geojson", "gpx", "kml", "mcap")
        refused(command("export", str(copy), "--format", formats[int(rng.integers(len(formats)))], "--force"))
    else:
        _read_run(copy, skip_damaged=what < 4)


def _read_run(folder: Path, skip_damaged: bool) -> None:
    from qrsim.runs import open_run
    from qrsim.runs.summary import summarise

    run = open_run(folder, skip_damaged=skip_damaged)
    for stream in run:
        if stream != "events":
            run.describe(stream)
            run[stream].arrays()
    _ = run.events, run.scenario
    summarise(run)


def _flight_log(shop: Workshop, rng: Rng) -> None:
    from qrsim.studies.flight_logs import read_log
    from qrsim.studies.flight_logs.inertial import read_inertial

    name, data, binary = shop.logs[int(rng.integers(len(shop.logs)))]
    path = shop.write(f"log{Path(name).suffix}", mutated(rng, data, binary))
    (read_inertial if name == "rest.ulg" else read_log)(path)


def _bag(shop: Workshop, rng: Rng) -> None:
    from qrsim.studies.flight_logs import read_log

    copy = shop.folder / "damaged"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(shop.bag, copy)
    files = sorted(copy.iterdir())
    chosen = files[int(rng.integers(len(files)))]
    chosen.write_bytes(mutated(rng, chosen.read_bytes(), binary=chosen.suffix == ".mcap"))
    # A file is also read alone, without its description.
    mcap = next(path for path in files if path.suffix == ".mcap")
    read_log(mcap if rng.random() < 0.5 else copy, "a_0")


def _buildings(shop: Workshop, rng: Rng) -> None:
    from qrsim.scenarios.scenario import load_scenario

    path = shop.write("block.geojson", mutated(rng, json.dumps(GEOJSON, indent=1).encode()))
    site = {"latitude_deg": 51.7119, "longitude_deg": -0.21052}
    world = {"buildings": {"file": str(path)}}
    load_scenario({"name": "x", "site": site, "world": world, "fleets": {"a": FLEET}}).world("float32")


def _heights(shop: Workshop, rng: Rng) -> None:
    from qrsim.scenarios.scenario import load_scenario

    path = shop.write("hills.asc", mutated(rng, HEIGHTS.encode()))
    world = {"ground": {"type": "dem", "file": str(path)}}
    load_scenario({"name": "x", "world": world, "fleets": {"a": FLEET}}).world("float32")


def _commands(shop: Workshop, rng: Rng) -> None:
    rows = "\n".join(f"{0.01 * i:g},0.0,0.59,0.0,12.0" for i in range(20))
    path = shop.write("commands.csv", mutated(rng, f"pitch,roll,throttle,yaw,battery\n{rows}\n".encode()))
    refused(command("openloop", str(path), "--output", str(shop.folder / "states.csv"), "--overwrite", "--units", "si"))


def _wind(shop: Workshop, rng: Rng) -> None:
    from qrsim.scenarios.scenario import load_scenario

    rows = "\n".join(f"{i},{1 + 0.1 * i:g},{-0.2 * i:g},0.0" for i in range(70))
    path = shop.write("wind.csv", mutated(rng, f"time,north,east,down\n{rows}\n".encode()))
    world = {"wind": {"type": "series", "file": str(path)}}
    load_scenario({"name": "x", "world": world, "fleets": {"a": FLEET}}).world("float32")


def _sp3(shop: Workshop, rng: Rng) -> None:
    from qrsim.scenarios.scenario import load_scenario

    path = shop.write("orbits.sp3", mutated(rng, sp3()))
    world = {"sky": {"orbits": {"type": "sp3", "file": str(path)}}}
    content = {"name": "x", "start_time": "2010-08-31T17:00:00Z", "world": world, "fleets": {"a": FLEET}}
    load_scenario(content).world("float32")


# How many of a hundred cases are of a kind.
KINDS: dict[str, tuple[int, Callable[[Workshop, Rng], None]]] = {
    "scenario": (20, _scenario),
    "flight": (3, _flight),
    "override": (6, _override),
    "vehicle": (4, _vehicle),
    "plan": (6, _plan),
    "kml": (6, _kml),
    "route": (4, _route),
    "study": (6, _study),
    "state": (6, _state),
    "run_folder": (8, _run),
    "flight_log": (7, _flight_log),
    "commands": (2, _commands),
    "wind": (4, _wind),
    "sp3": (5, _sp3),
    "buildings": (6, _buildings),
    "heights": (3, _heights),
    "bag": (4, _bag),
}


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Keep warnings to themselves."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
