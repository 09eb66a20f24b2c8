"""What independent errors do to a team: gusts and receivers that share nothing, everything, or what they truly share.

Flies the shipped study ``team_errors`` by ``qrsim sweep``: twenty Pelicans in a block that fly their own paths each, in
a block that flies by relative positions, and in a line that searches. All points have the same seeds, so conditions are
compared seed by seed. Intervals are of 95 %, over the seeds.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from evidence import IMAGES
from evidence import _intervals as interval
from qrsim.files.yaml_text import parse_yaml
from qrsim.scenarios.reading import dump_yaml

DOC = "a formation, relative navigation and a search under independent and shared gusts and GNSS errors, 200 seeds"
SEED = 0
STUDY = "team_errors"
PICTURE = IMAGES / "team_errors.png"
# Distance [m] that counts as a collision: a Pelican from tip to tip of its rotors, as the study's failure has it.
COLLISION_M = 0.65
METRICS = ("relative_error_rms_m", "relative_estimate_rms_m", "separation_min_m", "missed_share")
# Of the small form: parameters with fewer values, and what is changed everywhere.
FEWER: dict[str, Any] = {"team": ["line"], "turbulence": ["field"], "gnss": ["per_vehicle", "budget"]}
SMALL = ["--seeds", "3", "--workers", "1", "--set", "duration=25.0", "--set", "fleets.team.vehicles.count=6"]

Values = np.ndarray[Any, Any]


def flown(full: bool, folder: Path) -> Any:
    """Return the Dataset of the study, flown by ``qrsim sweep``."""
    import xarray as xr

    from qrsim.cli import main

    store, study = folder / f"{STUDY}.zarr", STUDY if full else str(fewer(folder / f"{STUDY}.yaml"))
    with contextlib.redirect_stdout(io.StringIO()):
        code = main(["sweep", study, *([] if full else SMALL), "--out", str(store)])
    assert code == 0, f"qrsim sweep {STUDY}: exit code {code}"
    return xr.open_zarr(store, consolidated=False).load()


def fewer(path: Path) -> Path:
    """Write the shipped study with fewer conditions, and return its path."""
    text = resources.files("qrsim.studies.sweep").joinpath(f"{STUDY}.yaml").read_text("utf-8")
    content = parse_yaml(text, STUDY)
    for name, kept in FEWER.items():
        conditions = content["vary"][name]["conditions"]
        content["vary"][name]["conditions"] = {each: conditions[each] for each in kept}
    # One size of batch, so that each program is compiled once.
    content["batch"] = 9
    path.write_text(dump_yaml(content), "utf-8")
    return path


def _key(spacing: float) -> str:
    return f"{spacing:g}".replace(".", "_")


def of_point(point: Any) -> dict[str, Any]:
    """Return means and the share of collisions of the seeds of one condition."""
    found: dict[str, Any] = {
        name: interval.mean(values)
        for name in METRICS
        if np.isfinite(values := np.asarray(point[name].values, np.float64)).all()
    }
    found["collided"] = interval.share(point["separation_min_m"].values < COLLISION_M)
    return found


def effects(data: Any) -> dict[str, Any]:
    """Return what changes, seed by seed, from the truth (one field, budget) to what is independent or less.

    Ratios are of means, differences are of shares.
    """

    def of(metric: str, other: Any, truth: Any) -> dict[str, float]:
        return interval.ratio(*(np.asarray(each[metric].values, np.float64) for each in (other, truth)))

    found: dict[str, Any] = {}
    for team in data.team.values:
        for spacing in data.spacing.values:
            here = data.sel(team=team, spacing=spacing)
            truth = here.sel(turbulence="field", gnss="budget")
            others = {
                "own_gusts": here.sel(turbulence="own", gnss="budget"),
                "per_vehicle": here.sel(turbulence="field", gnss="per_vehicle"),
                "common_only": here.sel(turbulence="field", gnss="common_only"),
                "both": here.sel(turbulence="own", gnss="per_vehicle"),
            }
            found.setdefault(str(team), {})[_key(float(spacing))] = {
                name: {
                    "error_ratio": of("relative_error_rms_m", other, truth),
                    "separation_ratio": of("separation_min_m", other, truth),
                    "collided_more": interval.mean(
                        (other["separation_min_m"].values < COLLISION_M).astype(np.float64)
                        - (truth["separation_min_m"].values < COLLISION_M)
                    ),
                }
                for name, other in others.items()
            }
    return found


def summary(data: Any) -> dict[str, Any]:
    """Return the numbers of all conditions, by team, turbulence, receivers and spacing."""
    found: dict[str, Any] = {}
    for team in map(str, data.team.values):
        for turbulence in map(str, data.turbulence.values):
            for gnss in map(str, data.gnss.values):
                at = found.setdefault(team, {}).setdefault(turbulence, {}).setdefault(gnss, {})
                for spacing in data.spacing.values:
                    at[_key(float(spacing))] = of_point(
                        data.sel(team=team, turbulence=turbulence, gnss=gnss, spacing=spacing)
                    )
    return found


def run(full: bool) -> dict[str, Any]:
    """Return all conditions and their effects; the full form draws the picture of docs/explanation/team_errors.md."""
    with tempfile.TemporaryDirectory() as folder:
        data = flown(full, Path(folder))
    found = {"seeds": data.sizes["seed"], "points": summary(data), "stopped": int(data["stopped"].sum())}
    if full:
        from evidence._team_pictures import draw

        found["effects"] = effects(data)
        draw(found["points"], PICTURE)
    return found
