"""The controls of one browser that let parts of the chosen vehicle fail while it flies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from qrsim.errors import UsageError
from qrsim.models.sensors.fault_numbers import TAKES
from qrsim.models.sensors.faults import KINDS
from qrsim.models.vehicles.fault_numbers import PARTS
from qrsim.scenarios.live_requests import Request, numbers_of
from qrsim.simulation.injections import OK, targets_of
from qrsim.world.state import Fleet, World

# What the numbers of a kind of a sensor are at first, and those of other parts by their names.
NUMBERS = {
    "wrong": "bias=5", "drift": "rate=0.5", "noisy": "std=2", "garbage": "range=50", "slow": "every=10",
    "delayed": "by=0.2", "intermittent": "share=0.5", "health": "health=0.7", "charge": "charge=0.2",
    "speed": "speed=0.5", "share": "share=0.5", "push": "acceleration_ned.x=2",
}  # fmt: skip
LONGEST_S = 1e6


@dataclass(frozen=True)
class Target:
    """A part that can be made to fail.

    Attributes:
        name: of the sensor, ``rotor N``, ``battery``, ``radio`` or ``body``.
        kinds: what can happen to it.
        fields: what a sensor reports.
        is_part: it is no sensor.
    """

    name: str
    kinds: tuple[str, ...]
    fields: tuple[str, ...] = ()
    is_part: bool = False

    def numbers(self, kind: str) -> str:
        """Return the default parameters of a kind of fault as editable text, such as "field=height bias=2"."""
        part = kind in TAKES and TAKES[kind].field and self.fields
        field = f"field={self.fields[0]} " if part else ""
        taken = PARTS[self.name.split()[0]][kind] if self.is_part else kind
        return f"{field}{NUMBERS.get(taken or '', '')}".strip()


def targets_of_all(world: World) -> list[list[Target]]:
    """Return for each vehicle of a world the sensors and parts that can be made to fail."""
    return [found for fleet in world.fleets for found in [_targets(fleet)] * fleet.size]


def _targets(fleet: Fleet) -> list[Target]:
    """Return the sensors of a fleet that have room for faults, then its vehicles' parts."""
    sensors = [Target(slot.sensor, KINDS, slot.fields) for slot in fleet.fault_slots]
    parts = [name for name in targets_of(fleet) if name not in fleet.sensor_names]
    return sensors + [Target(name, tuple(PARTS[name.split()[0]]), is_part=True) for name in parts]


class FailingControls:
    """Controls in the folder of the vehicle: target, kind, numbers, how long, and two buttons.

    Args:
        gui: of the browser.
        targets: of each vehicle.
        names: of the vehicles.
        ask: called with what is asked for.
        say: called with why it cannot be asked for, one line.
    """

    def __init__(
        self,
        gui: Any,
        targets: Sequence[Sequence[Target]],
        names: Sequence[str],
        ask: Callable[[Request], None],
        say: Callable[[str], None],
    ):
        self._targets, self._names, self._ask, self._say = targets, names, ask, say
        self._vehicle: int | None = None
        first = next(each for each in targets if each)
        self.target = gui.add_dropdown("Target", tuple(each.name for each in first), visible=False)
        self.kind = gui.add_dropdown("Kind", first[0].kinds, visible=False)
        self.numbers = gui.add_text("Numbers", "", hint="such as field=height bias=2", visible=False)
        self.seconds = gui.add_number("For [s]", 0.0, min=0.0, max=LONGEST_S, hint="0: for good", visible=False)
        self.inject = gui.add_button("Inject", visible=False)
        self.clear = gui.add_button("Clear", hint="ends the injected fault of the target", visible=False)
        self.target.on_update(lambda _: self._retarget())
        self.kind.on_update(lambda _: self._renumber())
        self.inject.on_click(lambda _: self.ask_inject())
        self.clear.on_click(lambda _: self.ask_clear())

    def show(self, vehicle: int | None) -> None:
        """Show the fault controls for this vehicle on the page; None hides them."""
        self._vehicle = vehicle
        own = [] if vehicle is None else self._targets[vehicle]
        if own:
            names = tuple(each.name for each in own)
            if self.target.options != names:
                self.target.options = names
            self._retarget()
        for control in (self.target, self.kind, self.numbers, self.seconds, self.inject, self.clear):
            control.visible = bool(own)

    def _chosen(self) -> Target | None:
        """Return the selected sensor or part of the chosen vehicle; None if no vehicle is chosen."""
        own = [] if self._vehicle is None else self._targets[self._vehicle]
        return next((each for each in own if each.name == self.target.value), None)

    def _retarget(self) -> None:
        """Update the menu of fault kinds to those of the selected sensor or part."""
        chosen = self._chosen()
        if chosen is not None and self.kind.options != chosen.kinds:
            self.kind.options = chosen.kinds
        self._renumber()

    def _renumber(self) -> None:
        """Fill in the default parameters of the selected kind of fault."""
        chosen = self._chosen()
        if chosen is not None:
            self.numbers.value = chosen.numbers(self.kind.value)

    def ask_inject(self) -> None:
        """Request the injection of the fault that the controls describe."""
        chosen = self._chosen()
        if chosen is None or self._vehicle is None:
            return
        try:
            numbers = numbers_of(self.numbers.value)
        except UsageError as error:
            self._say(f"Not injected: {error}")
            return
        names = (self._names[self._vehicle],)
        self._ask(
            Request(chosen.name, self.kind.value, names, duration=float(self.seconds.value) or None, numbers=numbers)
        )

    def ask_clear(self) -> None:
        """Request the end of all faults of the selected sensor or part."""
        chosen = self._chosen()
        if chosen is not None and self._vehicle is not None:
            self._ask(Request(chosen.name, OK, (self._names[self._vehicle],)))
