"""What each browser draws over the scene and does with its camera by itself (overlay.js): what it is told.

viser has one panel and one scene for all browsers; names, the ring round who is chosen, legend, scale bar, theme,
first view and following are each browser's own. An exported page has them too.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from qrsim.runs import colours
from qrsim.view.air import AIR, GUST, REACHES, WHOLE
from qrsim.view.differences import DIFFERENCES, differences_of
from qrsim.view.ellipsoids import UNCERTAINTY
from qrsim.view.ground import KEEP_OUTS, OBSTACLES, Obstacles
from qrsim.view.interference import INTERFERENCE
from qrsim.view.jets import WAKES
from qrsim.view.layers import MOST_LABELS, STRONG_WIND, Bodies, Layer, Stage
from qrsim.view.radio import LINKS
from qrsim.view.rays import RAYS
from qrsim.view.script import run_script
from qrsim.view.task import GOALS, LOCATIONS, SOURCES
from qrsim.view.thermals import THERMALS

# Where pages look from at first, seen from what is looked at, NED.
SOUTH = (-0.85, -0.3, -0.45)
# Parts of the overlay; the last one calls the others.
SCRIPTS = (
    "asking.js",
    "sky.js",
    "differences.js",
    "colourbar.js",
    "theme.js",
    "solids.js",
    "tools.js",
    "labels.js",
    "table.js",
    "overlay.js",
)
# Of the ground and the sky.
GROUNDS = {
    "light": {"plane_color": (226, 232, 214), "cell_color": (196, 205, 186), "section_color": (168, 178, 160)},
    "dark": {"plane_color": (38, 44, 44), "cell_color": (70, 78, 76), "section_color": (110, 120, 116)},
}
SURFACES = {"light": {"color": (205, 214, 186)}, "dark": {"color": (62, 72, 66)}}
SKIES = {
    "light": "linear-gradient(#cfdfec, #f4f7f8 55%)",
    "dark": "linear-gradient(#0f1418, #22292e 55%)",
}
# Layers that have the colours of the runs, where there are several.
ESTIMATES = ("estimated paths", "GNSS positions")
# The row of the legend that is only there once a vehicle has stopped.
STOPPED = "stopped"
# Of each layer: how its row of the legend is marked, the colours, the words.
ROWS: dict[str, list[tuple[str, Any, str]]] = {
    "vehicles": [("body", [colours.STOPPED], STOPPED)],
    "routes": [("thin", [colours.VEHICLES[0]], "route")],
    "true paths": [("line", [colours.VEHICLES[0]], "true path, last minute")],
    "estimated paths": [("thin", [colours.GREY], "estimated path")],
    "GNSS positions": [("ghost", [colours.GREY], "GNSS position")],
    "mean wind": [("scale", list(colours.WIND), f"mean wind, 0 to {STRONG_WIND:g} m/s and more")],
    "gusts": [("arrow", [colours.GUST], "gust")],
    AIR: [
        ("arrow", [colours.GUST], f"gust in a plane, {REACHES[GUST]:g} m/s a step"),
        ("scale", list(colours.WIND), f"or all of the wind, {REACHES[WHOLE]:g} m/s a step"),
    ],
    DIFFERENCES: [("thin", [colours.GREY], "from a vehicle to itself in another run, distance [m]")],
    LINKS: [("scale", list(colours.WIND), "radio at the receiver: no to all packets arrive; thin: last one lost")],
    INTERFERENCE: [("plate", [colours.GREY], "reach of a jammer, disc or spoofer, while it acts")],
    UNCERTAINTY: [("ghost", [colours.VEHICLES[0]], "95 % region of the estimate")],
    RAYS: [("thin", [colours.VEHICLES[0]], "satellite; dashed: reflected; grey: lost")],
    WAKES: [("arrow", [colours.GUST], "wake, down to 1 m/s")],
    THERMALS: [("plate", [colours.GUST], "thermal")],
    "area": [("thin", [colours.GREY], "flight area")],
    KEEP_OUTS: [("plate", [colours.KEEP_OUT], "zone to stay out of")],
    "persons": [("pin", [colours.MISSING], "person not found"), ("pin", [colours.FOUND], "person found")],
    "plume": [("body", [colours.PLUME], "plume")],
    GOALS: [("thin", [colours.GREY], "cross: goal of the task")],
    SOURCES: [("body", [colours.PLUME], "octahedron: source of the plume")],
    LOCATIONS: [("plate", [colours.GREY], "concentration asked for by the task")],
    "camera pictures": [("scale", list(colours.RATIO), "picture: no person to person")],
}


class Overlay:
    """What the browsers of a page draw over the scene.

    Args:
        server: of the page.
        stage: of the layers.
        bodies: of the vehicles.
        layers: that can be shown and hidden, by title.
        title: of the page, beside "qrsim".
        north: a place north of the origin that is marked, and the cell of the grid [m]; None: there is no grid.
    """

    def __init__(
        self,
        server: object,
        stage: Stage,
        bodies: Bodies,
        layers: dict[str, Layer],
        title: str,
        north: tuple[tuple[float, float, float], float | None],
    ):
        self._server = server
        self._said: dict[int, str] | None = None
        self._stated: dict[int, list[str]] = {}
        obstacles = layers.get(OBSTACLES)
        self._data = {
            "title": title,
            "css": _text("overlay.css") + _text("table.css"),
            "names": stage.cast.names,
            "runOf": None if stage.cast.run_of is None else stage.cast.run_of.tolist(),
            "colours": _plain(stage.palette),
            "colourOf": stage.hues.tolist(),
            "stopped": colours.STOPPED,
            "bodies": [(handle.name, members.tolist()) for members, handle in bodies.batches],
            "mostLabels": MOST_LABELS,
            "trueSpan": stage.cast.true_span,
            "from": SOUTH,
            "ways": np.round(stage.cast.ways, 2).tolist(),
            "frame": True,
            "north": north[0],
            "site": stage.cast.site,
            "surface": f"{layers['ground and north'].path}/surface",
            "obstacles": None if obstacles is None else obstacles.path,
            "obstacleNumbers": obstacles.numbers if isinstance(obstacles, Obstacles) else None,
            "layers": [layer.path for layer in layers.values()],
            "themes": {
                name: {f"{layers['ground and north'].path}/{node}": _plain(own) for node, own in parts.items()}
                for name, parts in {
                    theme: {"grid": GROUNDS[theme], "surface": SURFACES[theme]} for theme in GROUNDS
                }.items()
            },
            "skies": SKIES,
            "legend": _legend(stage, layers, north[1]),
            "differences": differences_of(stage),
        }
        self._send()

    def _send(self) -> None:
        """Send the overlay's scripts (labels, legend, camera) and their data to all browsers."""
        scripts = "\n".join(map(_text, SCRIPTS))
        run_script(self._server, "overlay", f"const data = {json.dumps(self._data)};\n{scripts}")

    def hold(self) -> None:
        """Make pages opened from now on begin with the scene's camera, not with a view of all vehicles."""
        self._data["frame"] = False
        self._send()

    def look_from(self, direction: tuple[float, float, float]) -> None:
        """Make pages opened from now on view all vehicles from a direction (3,) NED, as seen from the vehicles."""
        self._data["from"] = direction
        self._send()

    def say(self, reasons: dict[int, str]) -> None:
        """Show in browsers vehicle -> reason why it has stopped; of very many, only the last ones."""
        found = dict(list(reasons.items())[-MOST_LABELS:])
        if found != self._said:
            self._said = found
            self._tell("reasons", found, None)

    def states(self, lines: Mapping[int, list[str]]) -> None:
        """Show in browsers the lines of vehicle -> lines about its state in the vehicles' labels."""
        if lines != self._stated:
            self._stated = dict(lines)
            self._tell("states", self._stated, None)

    def choose(self, vehicle: int | None, browser: object = None) -> None:
        """Mark a vehicle in the scene as chosen (None: no vehicle), in one browser or, by default, all."""
        self._tell("choose", vehicle, browser)

    def follow(self, vehicle: int | None, browser: object = None) -> None:
        """Follow a vehicle with the camera (None: none), in one browser or, by default, all."""
        self._tell("follow", vehicle, browser)

    def identify(self, browser: Any) -> None:
        """Send a browser its own number, which its script needs to choose a vehicle in the table of vehicles."""
        self._tell("browser", browser.client_id, browser)

    def ride(self, vehicle: int, kind: str) -> None:
        """Let the camera of all browsers go with a vehicle, behind it ("chase") or at its nose ("onboard")."""
        self._tell("ride", {"vehicle": vehicle, "kind": kind}, None)

    def sky(self, told: Mapping[str, object] | None, browser: object) -> None:
        """Show satellites in one browser (message of ``view.sky.told``); None hides them."""
        self._tell("sky", told, browser)

    def paint(self, told: Mapping[str, object] | None) -> None:
        """Show the colour bar of a quantity in all browsers (message of ``Paint.told``); None hides it."""
        self._tell("paint", told, None)

    def _tell(self, what: str, content: object, browser: object) -> None:
        """Call function ``what`` of the overlay's script in one browser or, for None, in all."""
        # Also where the overlay's own script comes later.
        words = json.dumps(content)
        told = f"(window.qrsimTold ??= {{}}).{what} = {words}; window.qrsim?.{what}({words})"
        run_script(browser or self._server, what, told)


def _legend(stage: Stage, layers: dict[str, Layer], cell: float | None) -> list[dict[str, object]]:
    """Return the rows of the legend for JSON; ``cell``: size [m] of a grid cell."""
    rows: list[dict[str, object]] = []
    rows += [_row("body", [stage.palette[number]], name, "") for number, name in enumerate(stage.cast.runs)]
    if not rows and not stage.few and len(set(stage.cast.fleets.tolist())) > 1:
        for number in sorted(set(stage.cast.fleets.tolist())):
            first = stage.cast.names[int(np.argmax(stage.cast.fleets == number))]
            rows.append(
                _row("body", [stage.palette[number % len(stage.palette)]], first.rpartition("_")[0] or first, "")
            )
    for title, found in ROWS.items():
        if title not in layers:
            continue
        layer = layers[title]
        if stage.cast.run_of is not None and title in ESTIMATES:
            found = [(kind, [stage.palette[0]], words) for kind, _, words in found]
        # Of many vehicles all paths have one colour.
        if title == "true paths" and not stage.few:
            found = [("line", [stage.colours[0]], found[0][2])]
        rows += [_row(*row, layer.path) | {"ifStopped": row[2] == STOPPED} for row in found]
    rows.append(_row("size", [colours.GREY], "", layers["vehicles"].path))
    if cell is not None:
        rows.append(_row("thin", [colours.GREY], f"grid of {cell:g} m", layers["ground and north"].path))
    return rows


def _row(kind: str, own: Any, text: str, layer: str) -> dict[str, Any]:
    """Return a row of the legend for a layer; ``own``: its colours (red, green, blue), 0 to 255."""
    return {"kind": kind, "colours": [[int(part) for part in colour] for colour in own], "text": text, "layer": layer}


def _plain(values: object) -> Any:
    """Return colours, an array or a dict of arrays, as lists for JSON."""
    if isinstance(values, dict):
        return {name: list(own) for name, own in values.items()}
    return np.asarray(values).tolist()


def _text(name: str) -> str:
    """Return the text of a script or style sheet in this package."""
    return files("qrsim.view").joinpath(name).read_text("utf-8")
