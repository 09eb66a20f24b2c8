"""What labels say of vehicles besides their names: speed, height, battery, leg or failsafe, and the estimate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from qrsim.view.details import Details
from qrsim.view.frame import Frame
from qrsim.view.layers import MOST_LABELS, Layer

STATES = "states in labels"


class LabelStates(Layer):
    """Two or three lines in the labels of vehicles; browsers draw them.

    Selected vehicles always have them; shown, all vehicles have them, of up to 20.
    """

    title = STATES
    every = 6
    most = -1
    in_film = False
    of_chosen = always = True

    def begin(self) -> None:
        """Start with labels that have no lines about a vehicle's state."""
        self.tell: Callable[[dict[int, list[str]]], None] = lambda lines: None

    def draw(self, frame: Frame) -> None:
        """Send browsers the state lines of the vehicles that have labels."""
        size = self.stage.cast.size
        every = self.root.visible and size <= MOST_LABELS
        shown = range(size) if every else sorted(self.stage.chosen)
        lines: dict[int, list[str]] = {}
        if frame.details is not None and len(shown):
            found = frame.details()
            lines = {vehicle: self._lines(frame, found, vehicle) for vehicle in shown if frame.valid[vehicle]}
        self.tell(lines)

    def _lines(self, frame: Frame, found: Details, vehicle: int) -> list[str]:
        """Return the lines of text about one vehicle's state."""
        return lines_of(frame, found, vehicle, self.stage.cast.waypoints[vehicle])


def lines_of(frame: Frame, found: Details, vehicle: int, waypoints: int) -> list[str]:
    """Return the lines of a vehicle's label; unknown quantities are left out. ``waypoints``: number of its own."""
    speed, height = float(np.linalg.norm(found.velocity_ned[vehicle])), -float(frame.position_ned[vehicle, 2])
    lines = [f"{speed:.1f} m/s, {height:z.1f} m high"] if np.isfinite(speed + height) else []
    charge = float(found.charge[vehicle])
    parts = doing_of(found, vehicle, waypoints)
    parts += [f"battery {100.0 * charge:.0f} %"] if np.isfinite(charge) else []
    lines += [", ".join(parts)] if parts else []
    error = float(np.linalg.norm(found.believed_ned[vehicle] - frame.position_ned[vehicle]))
    std = float(np.linalg.norm(found.std_ned[vehicle]))
    if np.isfinite(error):
        reported = f" (sigma {std:.2g} m)" if np.isfinite(std) else ""
        lines.append(f"estimate {error:.2g} m off{reported}")
    return lines


def doing_of(found: Details, vehicle: int, waypoints: int) -> list[str]:
    """Return [text] of a vehicle's failsafe, else of its waypoint, such as "waypoint 2 of 5"; [] for neither."""
    mode, leg = found.modes.get(vehicle), float(found.waypoint[vehicle])
    if mode:
        return [mode]
    return [f"waypoint {min(leg + 1, waypoints):.0f} of {waypoints}"] if waypoints and np.isfinite(leg) else []
