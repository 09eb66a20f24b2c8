"""Write docs/images/task_FAMILY.png, an episode of each baseline: ``python -m docs.writers.task_pictures FAMILY ...``.

What is drawn as true is the truth of the simulation, which the policies do not see.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from docs.writers.pictures import write_named
from matplotlib.figure import Figure

from qrsim.core.vectors import Vec3
from qrsim.envs.batch import Batch
from qrsim.runs.picture import new_figure, save_picture
from qrsim.tasks import Play
from qrsim.tasks.baselines import baseline
from qrsim.world.episode import surroundings

IMAGES = Path(__file__).resolve().parents[1] / "images"
Values = np.ndarray[Any, Any]
COLOURS = ("tab:blue", "tab:green", "tab:purple")
# The last part of the pursuit, drawn on its own [s].
END_S = 60
# Of the picture of a search that is shown.
FEWEST_WINDOWS, MOST_RATIO = 150, 10.0


@dataclass(frozen=True)
class Flown:
    """An episode of a baseline.

    Attributes:
        play: task and world, with the numbers that the episode drew.
        policy: the baseline at the end.
        places: of each fleet (T, n, 3) true positions at the steps [m].
        seen: what the agents saw at each step.
        state: of the world at the end.
        memory: of the task at the end.
        total: the return without what was handed in, mean of the agents.
    """

    play: Play
    policy: Any
    places: list[Values]
    seen: list[Any]
    state: Any
    memory: Any
    total: float


def fly(scenario: str, seed: int) -> Flown:
    """Return an episode of the baseline of a scenario."""
    batch = Batch(scenario, 1)
    play = jax.tree.map(np.asarray, batch.functional.play)
    batch.reset(np.array([seed]))
    policy = baseline(play, seed)
    places: list[list[Values]] = []
    seen, total = [], 0.0
    for _ in range(play.steps):
        fleets = batch.episodes.episode(0).state.fleets
        places.append([np.asarray(fleet.vehicle.position_ned.stack()) for fleet in fleets])
        seen.append(jax.tree.map(lambda leaf: leaf[0], batch.seen))
        reward, terminated, _ = batch.step(np.asarray(policy.act(seen[-1]))[None])
        total += float(reward.mean())
        if terminated[0]:
            break
    last = batch.episodes.episode(0)
    play = Play(play.task, play.world.with_drawn(last.state.drawn), play.steps)
    return Flown(
        play, policy, [np.stack(each) for each in zip(*places, strict=True)], seen, last.state, last.memory, total
    )


def _ground(axes: Any, area: Any, title: str) -> None:
    """Finish a view from above, north up."""
    low, high = ([float(getattr(area, f"{axis}_{end}")) for axis in "yx"] for end in ("min", "max"))
    axes.plot([low[0], high[0], high[0], low[0], low[0]], [low[1], low[1], high[1], high[1], low[1]], "k-", lw=1.0)
    axes.set_aspect("equal")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.set_title(title, fontsize=10)


def pursuit(scenario: str = "cats_and_mouse/1C", seed: int = 3) -> Figure:
    """Draw the ways of cats and mouse, and how far from it they are."""
    flown = fly(scenario, seed)
    cats, mouse = flown.places[0], flown.places[1][:, 0]
    figure = new_figure(14.0, 5.0)
    whole, end, distances = figure.subplots(1, 3)
    for axes, first in ((whole, 0), (end, max(0, len(mouse) - END_S))):
        for i, name in enumerate(flown.play.agents):
            path = cats[first:, i]
            axes.plot(path[:, 1], path[:, 0], "-", color=COLOURS[i], lw=0.5 if axes is whole else 1.4, label=name)
            axes.plot(*path[-1, 1::-1], "o", color=COLOURS[i], ms=6)
        axes.plot(mouse[first:, 1], mouse[first:, 0], "-", color="tab:red", lw=0.8 if axes is whole else 1.8)
        axes.plot(*mouse[-1, 1::-1], "*", color="tab:red", ms=14, label="mouse, at the end")
    _ground(whole, flown.play.world.area, f"{len(mouse)} s: the cats lead the mouse round the middle")
    reach = float(flown.play.task.reach * flown.play.world.collision_distance)
    turn = np.linspace(0.0, 2.0 * np.pi, 100)
    end.plot(mouse[-1, 1] + reach * np.cos(turn), mouse[-1, 0] + reach * np.sin(turn), "r--", lw=1.0)
    end.set_aspect("equal")
    end.set_title(f"the last {END_S} s: they close in (dashed: near enough)", fontsize=10)
    end.set_xlabel("east [m]")
    end.legend(fontsize=8)
    away = np.linalg.norm(cats - mouse[:, None], axis=-1)
    for i, name in enumerate(flown.play.agents):
        distances.plot(away[:, i], color=COLOURS[i], lw=0.6, label=name)
    distances.axhline(reach, color="red", ls="--", label=f"near enough, {reach:g} m")
    distances.axhline(float(flown.play.world.collision_distance), color="black", ls=":", label="collision")
    distances.set_ylim(0.0, 24.0)
    distances.set_xlabel("time [s]")
    distances.set_ylabel("distance from the mouse [m]")
    distances.set_title(f"return {flown.total:.0f}", fontsize=10)
    distances.legend(fontsize=8, ncols=2)
    figure.suptitle(f"{scenario}: the baseline, seed {seed}")
    return figure


def plume_mapping(scenario: str = "plume_mapping/3C", seed: int = 6) -> Figure:
    """Draw the plumes, where they were measured, and what was handed in against the truth."""
    flown = fly(scenario, seed)
    area, plume = flown.play.world.area, flown.play.world.contents.plume
    field = flown.state.contents.plume
    sources = getattr(field, "sources", field)
    wind = surroundings(flown.play.world, flown.state.contents, jnp.int32(0)).carrying_wind(jnp.float32)

    def mean(north: Values, east: Values, down: Values) -> Values:
        flat = (jnp.asarray(np.ravel(axis), jnp.float32) for axis in np.broadcast_arrays(north, east, down))
        return np.asarray(plume.mean(field, Vec3(*flat), wind)).reshape(np.broadcast(north, east, down).shape)

    norths, easts = (np.linspace(float(getattr(area, f"{a}_min")), float(getattr(area, f"{a}_max")), 180) for a in "xy")
    downs = np.linspace(float(area.z_min), float(area.z_max), 33)
    highest = mean(norths[:, None, None], easts[None, :, None], downs[None, None]).max(axis=2)
    figure = new_figure(13.0, 5.6)
    above, compared = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    levels = [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0]
    filled = above.contourf(easts, norths, np.maximum(highest, 1e-9), levels, norm="log", cmap="Oranges", extend="max")
    figure.colorbar(filled, ax=above, label="true concentration, highest over all heights", format="{x:g}")
    path = flown.places[0][:, 0]
    locations = flown.memory.locations_ned
    above.plot(locations.y, locations.x, "o", mfc="none", color="0.35", ms=4, label="asked for, at all heights")
    above.plot(path[:, 1], path[:, 0], "-", color="tab:blue", lw=0.8, label="way of the vehicle")
    above.plot(path[0, 1], path[0, 0], "s", color="tab:blue", ms=8, label="start")
    there = np.asarray(sources.strength) > 0.0
    above.plot(sources.position_ned.y[there], sources.position_ned.x[there], "k*", ms=13, label="source")
    _ground(above, area, f"{len(path)} s of flight, seen from above")
    above.legend(fontsize=8, loc="lower right")
    true, handed = (
        mean(*(np.asarray(axis) for axis in (locations.x, locations.y, locations.z))),
        flown.policy.answer()[0],
    )
    compared.plot(true, handed, "o", ms=4, color="tab:blue", alpha=0.7, label=f"{len(true)} locations")
    top = 1.05 * max(float(true.max()), float(handed.max()))
    compared.plot([0.0, top], [0.0, top], "k--", lw=0.8, label="right")
    compared.set_xlabel("true concentration")
    compared.set_ylabel("handed in")
    compared.legend(fontsize=8, loc="upper left")
    score, nothing = -np.sum((handed - true) ** 2), -np.sum(true**2)
    compared.set_title(f"score {score:.2g}; zeros everywhere would have {nothing:.2g}", fontsize=10)
    figure.suptitle(f"{scenario}: the baseline, a fit of the plumes, seed {seed}")
    return figure


def _shown(flown: Flown, where: Values) -> tuple[int, int, Values]:
    """Return step and vehicle of the wide picture that speaks most clearly for a person, and whom it shows (P,)."""
    best: tuple[float, int, int, Values] = (-np.inf, 0, 0, np.zeros(len(where), bool))
    for step, seen in enumerate(flown.seen):
        for i, corners in enumerate(seen["corners"]):
            rows, columns = seen["grid"][i]
            if rows * columns < FEWEST_WINDOWS:
                continue
            axes = np.stack([corners[3] - corners[0], corners[1] - corners[0]], axis=1)
            place = (where - corners[0]) @ np.linalg.inv(axes).T
            inside = np.all((place > 0.1) & (place < 0.9), axis=1)
            window = (place[inside] * [rows, columns]).astype(int)
            clearest = float(np.max(seen["ratio"][i][window[:, 0], window[:, 1]], initial=-np.inf))
            if clearest > best[0]:
                best = (clearest, step, i, inside)
    return best[1:]


def search_and_rescue(scenario: str = "search_and_rescue/2D", seed: int = 1) -> Figure:
    """Draw the ways of the searchers, who was found, and what the classifier said of a picture."""
    flown = fly(scenario, seed)
    persons = flown.state.contents.persons
    there = np.asarray(persons.there)
    where = np.stack([persons.north, persons.east], axis=1)[there]
    found = np.asarray(persons.found_tick)[there] >= 0
    figure = new_figure(13.0, 6.2)
    above, ratios = figure.subplots(1, 2)
    for i, name in enumerate(flown.play.agents):
        path = flown.places[0][:, i]
        above.plot(path[:, 1], path[:, 0], "-", color=COLOURS[i], lw=1.2, label=name)
        above.plot(*path[0, 1::-1], "s", color=COLOURS[i], ms=6)
    above.plot(where[found, 1], where[found, 0], "o", color="tab:orange", mec="black", ms=10, label="person, found")
    above.plot(where[~found, 1], where[~found, 0], "x", color="black", ms=10, mew=2, label="person, not found")
    title = f"{len(flown.seen)} s, {int(found.sum())} of {len(found)} persons found, return {flown.total:.1f}"
    _ground(above, flown.play.world.area, title + " (squares: starts)")
    above.legend(fontsize=8, loc="lower right")
    step, i, inside = _shown(flown, where)
    seen = flown.seen[step]
    rows, columns = seen["grid"][i]
    down, across = np.meshgrid(np.arange(rows + 1) / rows, np.arange(columns + 1) / columns, indexing="ij")
    weights = np.stack([(1 - down) * (1 - across), (1 - down) * across, down * across, down * (1 - across)], axis=-1)
    corners = weights @ seen["corners"][i]
    values = seen["ratio"][i][:rows, :columns]
    drawn = ratios.pcolormesh(
        corners[..., 1], corners[..., 0], values, cmap="RdBu_r", vmin=-MOST_RATIO, vmax=MOST_RATIO
    )
    figure.colorbar(drawn, ax=ratios, extend="both", label="log-likelihood ratio: red speaks for a person")
    ratios.plot(where[inside, 1], where[inside, 0], "o", mfc="none", color="black", ms=16, mew=1.6, label="a person")
    height = -flown.places[0][step, i, 2]
    ratios.set_title(
        f"{flown.play.agents[i]} at {step} s, {height:.0f} m up: {rows} x {columns} windows of a picture", fontsize=10
    )
    ratios.set_aspect("equal")
    ratios.set_xlabel("east [m]")
    ratios.legend(fontsize=8)
    figure.suptitle(f"{scenario}: the baseline, seed {seed}")
    return figure


FAMILIES: dict[str, Callable[[], Figure]] = {
    "cats_and_mouse": pursuit,
    "plume_mapping": plume_mapping,
    "search_and_rescue": search_and_rescue,
}


def write(name: str) -> Path:
    """Write the picture of a family and return the file."""
    path = IMAGES / f"task_{name}.png"
    save_picture(FAMILIES[name], path)
    return path


def main(names: Sequence[str]) -> int:
    """Write the named pictures of tasks; return the exit code."""
    return write_named(names, "tasks", FAMILIES, write)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
