"""What a scenario says of the radio between vehicles, and presets (docs/explanation/models/radio.md)."""

from __future__ import annotations

from typing import Literal

from jax import Array

from qrsim.core.presets import Presets
from qrsim.core.tree import parameter, record, setting

# Built-up land about a station, by what its buildings do (models/radio/propagation.py).
Land = Literal["none", "suburban", "urban", "dense_urban", "high_rise"]
# Where radios are used, by the noise of what people run there.
ManMade = Literal["city", "residential", "rural", "quiet_rural", "none"]
PresetName = Literal["sik_915", "xbee_pro_900", "wifi_2g4", "lora_sf7", "lora_sf12", "sphere"]


@record
class PathLoss:
    """What a signal loses on its way."""

    exponent: Array = parameter(
        default=2.2, unit="", doc="by which power falls with distance; 2: free space", above=0.0
    )
    shadowing_db: Array = parameter(
        default=3.0, unit="dB", doc="standard deviation of the shadowing, the same for both directions", minimum=0.0
    )
    correlation_distance: Array = parameter(
        default=50.0, unit="m", doc="an end moved by it, the shadowing's correlation is 1/e", above=0.0
    )
    blocked_db: Array = parameter(
        default=20.0, unit="dB", doc="loss for each obstacle in the way, at most twice", minimum=0.0
    )
    waves: int = setting(default=32, doc="whose sum the shadowing is", minimum=1, maximum=1024)
    ground: Literal["two_ray", "none"] = setting(
        default="two_ray",
        doc="two_ray: the ground mirrors, and far away power falls with the fourth power of distance; none: no ground",
    )
    air_to_ground: Land = setting(
        default="none",
        doc="land between a station or a person on the ground and who is above; none: all links are alike",
    )
    ground_height: float = setting(
        default=5.0, unit="m", doc="up to which height above the ground one is on it, for air_to_ground", minimum=0.0
    )


@record
class Packet:
    """A packet, and when it is lost."""

    model: Literal["fsk", "bpsk", "threshold", "probability"] = setting(
        default="fsk",
        doc="law of the packet error rate: of a modulation, of a receiver's threshold, or of distance alone",
    )
    bytes: int = setting(default=60, doc="length on the air, headers and check sums included", minimum=1, maximum=65535)
    snr50_db: Array = parameter(
        default=10.0, unit="dB", doc="model 'threshold': signal to noise ratio at which half is lost"
    )
    width_db: Array = parameter(default=0.5, unit="dB", doc="model 'threshold': its steepness", above=0.0)
    range: Array = parameter(default=300.0, unit="m", doc="model 'probability': beyond it nothing is heard", above=0.0)
    probability: Array = parameter(
        default=1.0, unit="", doc="model 'probability': that a packet is heard within range", minimum=0.0, maximum=1.0
    )
    capture_db: Array = parameter(
        default=6.0, unit="dB", doc="a packet this much stronger than the others together is heard in spite of them"
    )
    preamble: float = setting(default=0.0, unit="s", doc="time on the air before the first byte", minimum=0.0)
    spreading_factor: int = setting(
        default=0, doc="of LoRa, which then says how long a packet is on the air; 0: no LoRa", minimum=0, maximum=12
    )


@record
class Mac:
    """Who may send when. Every vehicle sends at most one packet in a period."""

    type: Literal["ideal", "tdma", "aloha", "csma"] = setting(
        default="ideal",
        doc="ideal: all at once, undisturbed; tdma: each in its slot; aloha: at any time; csma: who listens first",
    )
    period: float = setting(default=0.2, unit="s", doc="a multiple of the time step", above=0.0)
    slots: int = setting(default=20, doc="of tdma in a period; vehicle i has slot i modulo slots", minimum=1)
    queue: int = setting(
        default=4, doc="messages that wait with a vehicle; of more, the oldest are lost", minimum=1, maximum=64
    )
    sense: Literal["packet", "noise"] = setting(
        default="packet",
        doc="whom csma waits for; packet: whose packets can be received there; noise: who is above the noise there",
    )
    attempts: int = setting(
        default=4, doc="of csma in a period, until a message has to wait for the next", minimum=1, maximum=16
    )


@record
class Delay:
    """What is added to the time on the air."""

    fixed: float = setting(default=0.005, unit="s", doc="processing at both ends", minimum=0.0)
    jitter: float = setting(
        default=0.002, unit="s", doc="median of what comes on top, log-normal with sigma 0.5", minimum=0.0
    )


@record
class InboxSize:
    """What a vehicle keeps of what it has heard, and how far is looked for who could be heard."""

    size: int = setting(default=8, doc="senders whose newest message is kept (K)", minimum=1, maximum=64)
    forget: float = setting(default=2.0, unit="s", doc="older messages are dropped", above=0.0)
    reach: Array = parameter(default=300.0, unit="m", doc="nobody farther is looked for", above=0.0)
    candidates: int = setting(
        default=24, doc="the nearest within reach, who can be heard at all", minimum=1, maximum=256
    )


# What a preset says is a default; its sources are in docs/explanation/models/radio.md.
PRESETS: Presets = {
    "sik_915": {
        "frequency_mhz": 915.0, "power_dbm": 20.0, "bandwidth_khz": 250.0, "rate_kbps": 64.0, "noise_figure_db": 6.0,
        "packet": {"model": "fsk"},
    },
    "xbee_pro_900": {
        "frequency_mhz": 915.0, "power_dbm": 17.0, "bandwidth_khz": 300.0, "rate_kbps": 156.0, "noise_figure_db": 6.0,
        "packet": {"model": "threshold", "snr50_db": 12.13},
    },
    "wifi_2g4": {
        "frequency_mhz": 2437.0, "power_dbm": 20.0, "bandwidth_khz": 20000.0, "rate_kbps": 6000.0,
        "noise_figure_db": 7.0, "packet": {"model": "threshold", "snr50_db": 10.89, "preamble": 20e-6},
    },
    "lora_sf7": {
        "frequency_mhz": 868.0, "power_dbm": 14.0, "bandwidth_khz": 125.0, "rate_kbps": 5.47, "noise_figure_db": 6.0,
        "packet": {"model": "threshold", "snr50_db": -8.6, "spreading_factor": 7, "bytes": 32},
    },
    "lora_sf12": {
        "frequency_mhz": 868.0, "power_dbm": 14.0, "bandwidth_khz": 125.0, "rate_kbps": 0.293, "noise_figure_db": 6.0,
        "packet": {"model": "threshold", "snr50_db": -21.1, "spreading_factor": 12, "bytes": 32},
        "mac": {"period": 2.0}, "inbox": {"forget": 20.0},
    },
    "sphere": {
        "packet": {"model": "probability"}, "man_made": "none",
        "path_loss": {"shadowing_db": 0.0, "blocked_db": 0.0, "ground": "none"},
    },
}  # fmt: skip
