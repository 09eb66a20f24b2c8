"""Write the pictures of the 3-D page and the README's figure: ``python -m docs.writers.pictures [NAME ...]``.

Each is what two commands make, and the documentation shows them: ``qrsim run`` flies, ``qrsim view --screenshot``
looks. Of the other pictures in docs/images the list says which command writes them.
"""

from __future__ import annotations

import contextlib
import io
import json
import shlex
import shutil
import sys
import tempfile
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from qrsim.errors import QrsimError, RunError, UsageError, did_you_mean

IMAGES = Path(__file__).resolve().parents[1] / "images"
# A scenario that is not built in: many vehicles, each on a square of its own.
SWARM, SWARM_SIZE = "swarm.yaml", 1000


@dataclass(frozen=True)
class Shot:
    """A picture of the page.

    Attributes:
        run: words of ``qrsim run``.
        view: words of ``qrsim view --screenshot``.
    """

    run: str
    view: str = ""

    def commands(self, name: str) -> str:
        """Return the commands that make the picture, one line."""
        words = f"{self.view} " if self.view else ""
        return f"qrsim run {self.run} --out {name}; qrsim view {name} {words}--screenshot {name}.png"


SHOTS = {
    "outdoor_patrol": Shot("outdoor_patrol --seed 1 --duration 20"),
    "keep_spot": Shot("keep_spot --seed 1 --duration 20", "--camera pelicans_0"),
    "cats_and_mouse": Shot("cats_and_mouse/1B --policy baseline --seed 3 --duration 20", "--camera above"),
    "plume_mapping": Shot("plume_mapping/3C --policy baseline --seed 2 --duration 90", "--camera area"),
    "search_and_rescue": Shot(
        "search_and_rescue/2D --policy baseline --seed 1 --duration 61", "--camera helicopters_1"
    ),
    "street_canyon": Shot(
        "street_canyon --set fleets.couriers.sensors.gnss.per_satellite=true --duration 22", "--camera courier"
    ),
    "mixed_team": Shot("mixed_team --seed 1 --duration 37"),
    "swarm": Shot(f"{SWARM} --seed 1 --duration 30"),
}
# The figure of a run, which the README shows.
FIGURE, FIGURE_RUN = "outdoor_patrol", "outdoor_patrol --seed 1"
# Who writes the other pictures; those of the gallery are made by the code of its pages.
GALLERY = sorted(page.stem for page in (IMAGES.parent / "gallery").glob("*.md") if page.stem != "index")
OTHERS = {
    **{f"gallery_{name}.png": f"python -m docs.writers.gallery {name}" for name in GALLERY},
    "slam_trajectories.png": "qrsim slam --seeds 8",
    "slam_allan.png": "qrsim slam --seeds 8",
    "slam_gain.png": "qrsim slam --vehicles 5 --seeds 8 --duration 60 --states poses",
    "wind_profile.png": "qrsim show windy_day.yaml --wind wind_profile.png, with docs/howto/wind_of_the_day.md's files",
    "task_cats_and_mouse.png": "make pictures",
    "task_plume_mapping.png": "make pictures",
    "task_search_and_rescue.png": "make pictures",
    "training.png": "make evidence training",
    "learning_curves.png": "make evidence learn:curves",
    "learning_keep_spot.png": "make evidence training:keep_spot",
    "learning_goto_waypoint.png": "make evidence training:goto_waypoint",
    "betaflight_identified.png": "make evidence betaflight",
    "estimator_nees.png": "make evidence estimator",
    "gnss_allan.png": "make evidence gnss",
    "gnss_canyon.png": "make evidence canyon",
    "gnss_day.png": "make evidence gnss",
    "gnss_fixes.png": "make evidence gnss",
    "gnss_jamming.png": "make evidence gnss",
    "imu_allan.png": "make evidence imu",
    "scan.png": "make evidence perception",
    "magnetometer_allan.png": "make evidence magnetometer",
    "pressure_altimeter.png": "make evidence air_data",
    "radio_delivery.png": "make evidence radio",
    "team_errors.png": "make evidence team_errors",
    "teams.png": "make evidence teams",
    "turbulence.png": "make evidence turbulence",
    "turbulence_field.png": "make evidence field",
    "thermal.png": "make evidence thermal",
    "turbulence_line.png": "make evidence field",
    "turbulence_gust.gif": "make evidence formation_gusts",
    "turbulence_spacing.png": "make evidence formation_gusts",
    "brief.png": "qrsim brief mission.plan --vehicle x500 --wind 7@250 --at 2026-05-01T10:00Z",
    "real_place.png": "qrsim run examples/real_place/site.yaml",
    "real_place_brief.png": "qrsim brief examples/real_place/operation.yaml --stage nominal --minutes 0.1",
    "brief_wind.png": "qrsim brief mission.plan --vehicle x500 --wind 7@250 --at 2026-05-01T10:00Z --stage wind",
    "zones.png": "qrsim run field_day.yaml",
}


def every() -> dict[str, str]:
    """Return the command of each picture in docs/images, by its name."""
    shots = {f"view_{name}.png": shot.commands(name) for name, shot in SHOTS.items()}
    return shots | {f"{FIGURE}.png": f"qrsim run {FIGURE_RUN}"} | OTHERS


def _command(*words: str) -> None:
    """Run qrsim; what it prints on standard output is nothing new."""
    from qrsim import cli

    with contextlib.redirect_stdout(io.StringIO()):
        code = cli.main(list(words))
    if code:
        raise RunError(f"qrsim {shlex.join(words)}: exit code {code}")


def write(name: str, output: Path = IMAGES) -> Path:
    """Fly, and write a picture of the page or, of the name "figure", the README's; return where it is.

    Raises:
        RunError: there is no browser, or a command failed.
    """
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        if name == "figure":
            _command("run", *shlex.split(FIGURE_RUN), "--out", name)
            return Path(shutil.copy(Path(name) / "figure.png", output / f"{FIGURE}.png"))
        shot = SHOTS[name]
        if shot.run.startswith(SWARM):
            from evidence.view import patrol

            # JSON is YAML.
            Path(SWARM).write_text(json.dumps(patrol(SWARM_SIZE)), encoding="utf-8")
        _command("run", *shlex.split(shot.run), "--out", name, "--no-figure")
        _command("view", name, *shlex.split(shot.view), "--screenshot", f"{name}.png")
        return _smaller(Path(f"{name}.png"), output / f"view_{name}.png")


def _smaller(found: Path, path: Path) -> Path:
    """Copy a picture with 256 colours, a fifth of the size; such that rare ones, as in a legend, stay as they are."""
    from PIL import Image

    few = Image.open(found).convert("RGB").quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(path, optimize=True)
    return path


def write_named(names: Sequence[str], kind: str, known: Collection[str], draw: Callable[[str], Path]) -> int:
    """Write the named pictures, all that are known where none is named; return the exit code."""
    try:
        for name in names:
            if name not in known:
                raise UsageError(f"no family of {kind} '{name}'{did_you_mean(name, known)}")
        for name in names or known:
            print(draw(name))
    except QrsimError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def main(names: Sequence[str]) -> int:
    """Write the named pictures; return the exit code."""
    return write_named(names, "scenarios", (*SHOTS, "figure"), write)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
