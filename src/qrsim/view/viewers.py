"""What each browser has for itself on a page: the vehicle it has chosen, whether it follows it, and its plots."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from viser import ClientHandle

from qrsim.core.arrays import Floats
from qrsim.view.failing import FailingControls
from qrsim.view.scene import Scene
from qrsim.view.sky import Satellite, told

Plotted = Callable[[int, str], tuple[Floats, Floats, Floats]]
NOBODY = "(nobody)"
# A plot has at most so many points; below: how many plots there are, and their place in the panel.
MOST_POINTS, PLOTS, ORDER = 300, 2, 4.0
TRUE_COLOUR = "#8a8f94"


@dataclass
class Choice:
    """What a browser looks at.

    Attributes:
        vehicle: number; None: nobody.
        follow: whether its camera goes with it.
    """

    vehicle: int | None = None
    follow: bool = False


class Viewer:
    """The panel of one browser.

    Args:
        client: the browser, as viser has it.
        scene: that it looks at.
        choice: what it looks at, at first.
        quantities: that can be plotted.
        plotted: returns for a vehicle and a quantity its (times, measured, true), each (K,); None: nothing is.
        chosen: called after the choice has changed.
        sky: returns the satellites of a vehicle, none where nothing is known of them.
        failing: adds controls that let parts of the chosen vehicle fail, where there are any.
    """

    def __init__(
        self,
        client: ClientHandle,
        scene: Scene,
        choice: Choice,
        quantities: list[str],
        plotted: Plotted | None,
        chosen: Callable[[], None],
        sky: Callable[[int], list[Satellite]] = lambda vehicle: [],
        failing: Callable[[Any], FailingControls] | None = None,
    ):
        self.choice = Choice(choice.vehicle, choice.follow)
        self._client, self._scene, self._plotted, self._changed = client, scene, plotted, chosen
        self._sky = sky
        self._told: dict[str, object] | None = None
        gui, names = client.gui, scene.cast.names
        gui.reset()
        self.folder = gui.add_folder("Vehicle", order=ORDER)
        with self.folder:
            self.who: Any = gui.add_dropdown(
                "Name", (NOBODY, *names), hint="or click a vehicle", initial_value=self._name
            )
            self.follows: Any = gui.add_checkbox("Follow", choice.follow, visible=choice.vehicle is not None)
            self.plots = [self._add_plot(gui, quantities, i) for i in range(min(PLOTS, len(quantities)))]
            self.failing = None if failing is None else failing(gui)
        self.who.on_update(lambda _: self._named())
        self.follows.on_update(lambda _: self.follow(self.follows.value))
        scene.overlay.identify(client)
        self._show()

    @property
    def _name(self) -> str:
        """Name of the chosen vehicle, or the menu's entry for none."""
        vehicle = self.choice.vehicle
        return NOBODY if vehicle is None else self._scene.cast.names[vehicle]

    def _add_plot(self, gui: Any, quantities: list[str], number: int) -> tuple[Any, Any]:
        """Add a menu of readings and a plot to the panel; return the handles of both."""
        shown = self.choice.vehicle is not None
        choice = gui.add_dropdown("Reading", quantities, initial_value=_first_choice(quantities, number), visible=shown)
        # Some times, because a plot that begins without any never finds its scale.
        empty = (np.array([0.0, 1.0]), *(np.full(2, np.nan),) * 2)
        plot = gui.add_uplot(empty, self._series(), scales={"x": {"time": False}}, height=150, visible=shown)
        choice.on_update(lambda _: self.plot())
        return choice, plot

    def _series(self) -> Any:
        """Return the options of a plot's lines: time, measured (in the vehicle's colour), true."""
        colour = self._scene.stage.colours[self.choice.vehicle or 0]
        stroke = "#{:02x}{:02x}{:02x}".format(*colour.tolist())
        return (
            {"label": "t"},
            {"label": "measured", "stroke": stroke, "width": 2},
            {"label": "true", "stroke": TRUE_COLOUR, "width": 1.5},
        )

    def _named(self) -> None:
        """Choose the vehicle that the user has selected in the menu of names."""
        name = self.who.value
        vehicle = None if name == NOBODY else self._scene.cast.names.index(name)
        if vehicle != self.choice.vehicle:
            self.choose(vehicle)

    def choose(self, vehicle: int | None) -> None:
        """Choose a vehicle (None: none), plot its readings, and follow it if following is on."""
        self.choice.vehicle = vehicle
        if self.who.value != self._name:
            self.who.value = self._name
        self._changed()
        self._show()

    def follow(self, follow: bool) -> None:
        """Start or stop the camera's following the chosen vehicle."""
        self.choice.follow = follow
        if self.follows.value != follow:
            self.follows.value = follow
        self._show()

    def _show(self) -> None:
        """Show or hide satellites, plots and fault controls, depending on the chosen vehicle."""
        vehicle, overlay = self.choice.vehicle, self._scene.overlay
        overlay.choose(vehicle, self._client)
        overlay.follow(vehicle if self.choice.follow else None, self._client)
        self.follows.visible = vehicle is not None
        for choice, plot in self.plots:
            choice.visible = plot.visible = vehicle is not None
            plot.series = self._series()
        if self.failing is not None:
            self.failing.show(vehicle)
        self.plot()
        self.send_sky()

    def send_sky(self) -> None:
        """Send the browser the satellites of the chosen vehicle's receiver, if they have changed."""
        vehicle = self.choice.vehicle
        found = [] if vehicle is None else self._sky(vehicle)
        now = told(self._name, found)
        if now != self._told:
            self._told = now
            self._scene.overlay.sky(now, self._client)

    def plot(self) -> None:
        """Redraw the plots of the chosen vehicle."""
        if self.choice.vehicle is None or self._plotted is None:
            return
        for choice, plot in self.plots:
            found = self._plotted(self.choice.vehicle, choice.value)
            if len(found[0]) > 1:
                every = math.ceil(len(found[0]) / MOST_POINTS)
                # The newest is always one of them.
                plot.data = tuple(values[::-every][::-1].astype(np.float64) for values in found)


def _first_choice(quantities: list[str], number: int) -> str:
    """Return the quantity that plot ``number`` shows at first: one with instructive errors, if it is measured."""
    wanted = ("position_ned.x", "height")
    return next((q for q in quantities if q.endswith(wanted[number])), quantities[number])
