"""Links of the radio as a run folder has them: who heard whom, by period, and how connected the vehicles were."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import RunError, UsageError
from qrsim.models.radio.links import Outcome
from qrsim.runs.radio_columns import links_logged
from qrsim.runs.reader import Run
from qrsim.runs.summary import stops_of
from qrsim.world.state import period_ticks

STREAM = "measurements"


@dataclass(frozen=True)
class Packets:
    """What became of packets to n vehicles from the K nearest of each, in P periods.

    Attributes:
        time: (P,) [s] of the first recorded tick after each period's exchange.
        sender: (P, K, n) number of a vehicle; -1: nobody sent.
        outcome: (P, K, n) see ``Outcome``.
        rssi: (P, K, n) [dBm].
        flies: (P, n) whether the receiver has not stopped.
    """

    time: NumpyArray
    sender: NumpyArray
    outcome: NumpyArray
    rssi: NumpyArray
    flies: NumpyArray

    @property
    def meant(self) -> NumpyArray:
        """Mask (P, K, n): a packet was sent to the receiver; P periods, K nearest senders, n receivers."""
        return (self.sender >= 0) & (self.outcome != Outcome.NOTHING)

    @property
    def heard(self) -> NumpyArray:
        """Mask (P, K, n): a packet was sent and received; P periods, K nearest senders, n receivers."""
        return (self.sender >= 0) & (self.outcome == Outcome.HEARD)

    def part(self, rows: NumpyArray) -> Packets:
        """Return the packets of the periods with indices ``rows``."""
        return Packets(self.time[rows], self.sender[rows], self.outcome[rows], self.rssi[rows], self.flies[rows])

    def counts(self) -> tuple[NumpyArray, NumpyArray, NumpyArray]:
        """Return three arrays (n, n) by sender and receiver: packets sent, packets received, mean strength [dBm] or
        NaN."""
        n = self.flies.shape[1]
        pair = np.where(self.sender >= 0, self.sender, 0) * n + np.arange(n)

        def total(which: NumpyArray, weights: NumpyArray | None = None) -> NumpyArray:
            """Return sums (n, n) by sender and receiver over the packets in a mask, each with its weight or 1."""
            chosen = None if weights is None else weights[which].astype(np.float64)
            return np.bincount(pair[which], weights=chosen, minlength=n * n).reshape(n, n)

        sent, heard, strength = total(self.meant), total(self.heard), total(self.heard, self.rssi)
        return sent, heard, np.divide(strength, heard, out=np.full((n, n), np.nan), where=heard > 0)


def packets_of(run: Run, start: float | None = None, end: float | None = None) -> Packets:
    """Return the radio packets that a run logged in a span of time [s].

    Raises:
        UsageError: the run has no radio, or no period in the span.
        RunError: nothing was recorded yet.
    """
    stream = run[STREAM]
    slots = links_logged(stream.columns())
    if not slots:
        raise UsageError(f"{run.folder}: its vehicles have no radio; a scenario with world.radio gives them one")
    if not len(stream.time):
        raise RunError(f"{run.folder}: nothing to draw, because no tick was recorded (state: {run.info.state})")
    ticks = period_ticks(run.scenario["world"]["radio"]["mac"]["period"], run.info.time_step)
    # The first tick of each period at which its links are known; what was logged later of it is the same.
    period = (stream.tick - 1) // ticks
    first = np.flatnonzero(np.diff(period, prepend=period[0] - 1) > 0)
    first = first[stream.tick[first] > 0]
    slack = 1e-6 * run.info.time_step
    low = -np.inf if start is None else start - slack
    high = np.inf if end is None else end + slack
    rows = first[(stream.time[first] >= low) & (stream.time[first] <= high)]
    if not len(rows):
        raise UsageError(
            f"{run.folder}: no period of the radio was logged in that span; the log goes from {stream.time[0]:g} s to "
            f"{stream.time[-1]:g} s"
        )
    read = {
        name: np.stack([stream[f"radio.{name}.{k}"][rows] for k in range(slots)], axis=1)
        for name in ("sender", "outcome", "rssi")
    }
    stops = stops_of(run)
    last = [stops[i].tick if i in stops else np.inf for i in range(len(run.vehicles))]
    flies = stream.tick[rows][:, None] <= np.array(last)
    return Packets(stream.time[rows], read["sender"], read["outcome"], read["rssi"], flies)


def radios_of(run: Run) -> NumpyArray:
    """Return a bool array (n,) of which vehicles of the run have a radio."""
    fleets = run.scenario["fleets"].values()
    own = [(fleet.get("radio") or {}).get("works", True) is not False for fleet in fleets]
    found = np.repeat(own, [len(fleet["vehicles"]) for fleet in fleets])
    return found if len(found) == len(run.vehicles) else np.ones(len(run.vehicles), bool)


def out_of_reach(packets: Packets, sent: NumpyArray, radios: NumpyArray) -> int | None:
    """Return how many packets had a receiver out of reach, summed over the receivers; None if the log does not tell.

    The number is known if every flying vehicle with a radio sends to all in each period, and all links are logged.

    Args:
        packets: of P periods.
        sent: (P, n) packets that each vehicle has sent since the start.
        radios: (n,) bool: the vehicle has a radio.
    """
    there, links = packets.flies & radios, packets.sender >= 0
    count = there.sum(axis=1)
    all_send = (np.diff(sent, axis=0, prepend=0) == there).all()
    if not all_send or (links & ~packets.meant).any() or count.max() - 1 > packets.sender.shape[1]:
        return None
    return int((count * (count - 1)).sum() - links.sum())


@dataclass(frozen=True)
class Connectivity:
    """How connected the vehicles were, in bins of time (B,).

    Attributes:
        time: end of each bin [s].
        delivery: (B,) part of the packets that was heard; NaN: none was sent.
        lost: by name, (B,) part that was too weak, lost by chance, or to others.
        components: (B,) groups of those that fly, within which everybody can reach everybody, hop by hop.
        largest: (B,) part of those that fly in the largest of these groups.
    """

    time: NumpyArray
    delivery: NumpyArray
    lost: dict[str, NumpyArray]
    components: NumpyArray
    largest: NumpyArray


def connectivity(packets: Packets, bins: int, radios: NumpyArray) -> Connectivity:
    """Return radio connectivity in ``bins`` of time; a link is a pair that received packets both ways within a bin.

    Args:
        packets: of P periods.
        bins: of time, at most P.
        radios: (n,) bool: the vehicle has a radio; others do not count.
    """
    parts = np.array_split(np.arange(len(packets.time)), min(bins, len(packets.time)))
    kinds = {"too weak": Outcome.WEAK, "by chance": Outcome.NOISE, "to others": Outcome.COLLISION}
    table = []
    for rows in parts:
        own = packets.part(rows)
        meant = own.meant.sum()
        counts = [own.heard.sum(), *((own.meant & (own.outcome == kind)).sum() for kind in kinds.values())]
        table.append([*(count / meant if meant else np.nan for count in counts), *components_of(own, radios)])
    delivery, *lost, components, largest = np.array(table, np.float64).T
    ends = packets.time[[rows[-1] for rows in parts]]
    return Connectivity(ends, delivery, dict(zip(kinds, lost, strict=True)), components, largest)


def components_of(packets: Packets, radios: NumpyArray) -> tuple[int, float]:
    """Return the number of connected groups of flying vehicles with radios, and the fraction in the largest."""
    # Slow to import, and pages of runs without radios never come here.
    from scipy.sparse.csgraph import connected_components

    there = np.flatnonzero(packets.flies[-1] & radios)
    if not len(there):
        return 0, float("nan")
    _, heard, _ = packets.counts()
    both = (heard > 0) & (heard.T > 0)
    count, group = connected_components(both[np.ix_(there, there)], directed=False)
    return int(count), float(np.bincount(group).max() / len(there))
