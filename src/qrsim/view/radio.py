"""Links of the radio: of each the half at who hears, in the colour of its quality.

See docs/explanation/models/radio.md.
"""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.radio.links import Outcome
from qrsim.runs.colours import WIND, on_scale
from qrsim.view import shapes
from qrsim.view.frame import Frame, Links
from qrsim.view.layers import Layer, Stage
from qrsim.world.state import World

LINKS = "radio links"
# Packets that are lost with more than this chance are not drawn: nobody counts on them.
FAINTEST = 0.02
# So many halves are drawn at most, the best ones first.
MOST_DRAWN = 600
# Thickness, in spans of a vehicle: of a packet that was heard, and of one that was lost.
THICK, THIN = 0.09, 0.03


class RadioLinks(Layer):
    """Half a line from each vehicle towards whom it can hear; thin where the last packet was lost."""

    title = LINKS
    every, beside = 3.0, True
    most = 200
    most_in_film = 300

    def begin(self) -> None:
        """Add the lines of radio links to the scene, hidden at first."""
        size = self.stage.cast.size
        room = self._room = min(MOST_DRAWN, size * (size - 1))
        self._handle = self.several(
            "halves",
            shapes.box((0.0, -0.5, -0.5), (1.0, 0.5, 0.5)),
            np.zeros((room, 3)),
            np.tile(shapes.linear(WIND[-1]), (room, 1)),
        )

    def draw(self, frame: Frame) -> None:
        """Draw the lines along the radio links of the last period before a frame."""
        if frame.links is None:
            return
        start, vector, arrives, heard = halves(frame.links, frame.position_ned, frame.valid)
        best = np.argsort(-arrives, kind="stable")[: self._room]
        wide = np.where(heard[best], THICK, THIN) * self.stage.span
        count = len(best)
        scales = np.zeros((self._room, 3), np.float32)
        scales[:count] = np.stack([np.linalg.norm(vector[best], axis=1), wide, wide], axis=1)
        self._handle.batched_positions = _filled(start[best], self._room, np.zeros(3))
        self._handle.batched_wxyzs = _filled(shapes.along(vector[best]), self._room, np.array([1.0, 0.0, 0.0, 0.0]))
        self._handle.batched_scales = scales
        colours = shapes.linear(on_scale(WIND, arrives[best]))
        self._handle.batched_colors = _filled(colours, self._room, np.zeros(3)).astype(np.uint8)


def halves(links: Links, position_ned: Floats, valid: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return half-lines of links: start, vector (L, 3) [m], arrival chance, whether the last packet arrived (L,).

    Args:
        links: of the last period.
        position_ned: (n, 3) of the vehicles [m].
        valid: (n,) which of them fly.

    Returns:
        Also (L,) the chance that a packet arrives if nobody else sends, and (L,) whether the last one did.
    """
    slot, receiver = np.nonzero((links.sender >= 0) & (1.0 - links.error >= FAINTEST))
    sender = links.sender[slot, receiver].astype(int)
    known = valid[sender] & valid[receiver] & np.isfinite(position_ned[sender] + position_ned[receiver]).all(axis=1)
    slot, receiver, sender = slot[known], receiver[known], sender[known]
    start = position_ned[receiver]
    return (
        start,
        0.5 * (position_ned[sender] - start),
        1.0 - links.error[slot, receiver],
        links.outcome[slot, receiver] == Outcome.HEARD,
    )


def _filled(rows: Floats, room: int, filler: Floats) -> Floats:
    """Return ``rows`` padded to ``room`` rows with copies of the row ``filler``."""
    return np.concatenate([rows, np.broadcast_to(filler, (room - len(rows), len(filler)))])


def radio_layers(stage: Stage, world: World) -> list[Layer]:
    """Return a list with the layer of radio links, [] in a world without a radio or with one vehicle."""
    return [RadioLinks(stage)] if world.radio is not None and stage.cast.size > 1 else []
