"""The channel that all radios of a world share, and the part of each fleet.

See docs/explanation/models/radio.md.
"""

from __future__ import annotations

import math
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import LARGEST_NORMAL
from qrsim.core.presets import Presets
from qrsim.core.tree import derived, parameter, quantity, record, setting
from qrsim.models.radio.parameters import PRESETS, Delay, InboxSize, Mac, ManMade, Packet, PathLoss, PresetName
from qrsim.models.radio.propagation import lora_air_time, noise_floor, with_man_made

# Of the logarithm of the jitter.
JITTER_SIGMA = 0.5


@record
class FleetRadios:
    """Parameters of the radios of fleets that differ from the network's, each (n,); NaN: as in the network."""

    power_dbm: Array = quantity(unit="dBm", doc="transmitted power")
    gain_db: Array = quantity(unit="dB", doc="gain of the antenna")
    noise_figure_db: Array = quantity(unit="dB", doc="noise figure of the receiver")
    works: Array = quantity(doc="bool: there is a radio")

    def power(self, usual: Array) -> Array:
        """Return the transmitted power (n,) [dBm] of each radio, ``usual`` for radios without their own value."""
        return _or_usual(self.power_dbm, usual)

    def gain(self, usual: Array) -> Array:
        """Return the antenna gain (n,) [dB] of each radio, ``usual`` for radios without their own value."""
        return _or_usual(self.gain_db, usual)

    def noise(self, usual: Array) -> Array:
        """Return the noise figure (n,) [dB] of each receiver, ``usual`` for radios without their own value."""
        return _or_usual(self.noise_figure_db, usual)


def _or_usual(own: Array, usual: Array) -> Array:
    """Return each radio's own value (n,), or ``usual`` where that is NaN."""
    return jnp.where(jnp.isnan(own), usual, own)


@record
class Channel:
    """One channel for all vehicles of a world."""

    presets: ClassVar[Presets] = PRESETS

    preset: PresetName = setting(default="sik_915", doc="radio that provides the parameters left out")
    frequency_mhz: Array = parameter(default=915.0, unit="MHz", doc="carrier frequency", above=0.0)
    power_dbm: Array = parameter(default=20.0, unit="dBm", doc="transmitted power")
    gain_db: Array = parameter(default=0.0, unit="dB", doc="gain of each antenna")
    bandwidth_khz: float = setting(default=250.0, unit="kHz", doc="bandwidth of the receiver's filter", above=0.0)
    rate_kbps: float = setting(default=64.0, unit="kbit/s", doc="bit rate on the air", above=0.0)
    noise_figure_db: Array = parameter(default=6.0, unit="dB", doc="noise figure of the receiver", minimum=0.0)
    man_made: ManMade = setting(
        default="residential",
        doc="land use that sets the man-made noise at receivers; none: thermal noise alone",
    )
    size: int = setting(default=6, doc="numbers in a message (D)", minimum=1, maximum=256)
    beacon: bool = setting(
        default=True, doc="vehicles without a message send their estimated position and velocity in every period"
    )
    path_loss: PathLoss = quantity(default=PathLoss(), doc="path loss")
    packet: Packet = quantity(default=Packet(), doc="packets, and the law by which they are lost")
    mac: Mac = quantity(default=Mac(), doc="medium access")
    delay: Delay = quantity(default=Delay(), doc="latency in addition to the time on the air")
    inbox: InboxSize = quantity(default=InboxSize(), doc="messages that a vehicle keeps")
    own: FleetRadios | None = derived(default=None, doc="parameters of single fleets, a FleetRadios; None: none")

    @property
    def field_ids(self) -> int:
        """Number of random waves that make up the shadowing (large-scale fading)."""
        return self.path_loss.waves

    @property
    def noise_dbm(self) -> Array:
        """Noise power of the receivers [dBm]: () for all, or (n,) for each."""
        figure = self.noise_figure_db if self.own is None else self.own.noise(self.noise_figure_db)
        figure = with_man_made(figure, self.frequency_mhz, self.man_made)
        return noise_floor(1000.0 * self.bandwidth_khz, figure)

    @property
    def asks_height(self) -> bool:
        """True if the path loss depends on the radios' heights above the ground."""
        return self.path_loss.air_to_ground != "none" or self.path_loss.ground == "two_ray"

    @property
    def air_time(self) -> float:
        """Time that a packet occupies the channel [s]."""
        if self.packet.spreading_factor:
            return lora_air_time(self.packet.bytes, self.packet.spreading_factor, 1000.0 * self.bandwidth_khz)
        return self.packet.preamble + 8.0 * self.packet.bytes / (1000.0 * self.rate_kbps)

    @property
    def latest(self) -> float:
        """Longest time [s] from the beginning of a period until a packet sent in it arrives."""
        begin = {"ideal": 0.0, "tdma": self.mac.period * (1.0 - 1.0 / self.mac.slots)}
        first = begin.get(self.mac.type, self.mac.period) + self.air_time
        return first + self.delay.fixed + self.delay.jitter * math.exp(JITTER_SIGMA * LARGEST_NORMAL)

    @property
    def periods_on_the_way(self) -> int:
        """Number F of radio periods in which packets were sent that may not have arrived yet."""
        return max(1, math.ceil(self.latest / self.mac.period - 1e-9))
