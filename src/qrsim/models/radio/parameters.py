"""Parameters of the radio between vehicles, and presets (docs/explanation/models/radio.md)."""

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
    """Path loss of a signal."""

    exponent: Array = parameter(default=2.2, unit="", doc="exponent of the path loss; 2: free space", above=0.0)
    shadowing_db: Array = parameter(
        default=3.0, unit="dB", doc="standard deviation of the shadowing, equal in both directions", minimum=0.0
    )
    correlation_distance: Array = parameter(
        default=50.0,
        unit="m",
        doc="displacement of one end over which the shadowing's correlation falls to 1/e",
        above=0.0,
    )
    blocked_db: Array = parameter(
        default=20.0, unit="dB", doc="loss for each obstacle on the line of sight, at most two", minimum=0.0
    )
    waves: int = setting(default=32, doc="number of waves that the shadowing is the sum of", minimum=1, maximum=1024)
    ground: Literal["two_ray", "none"] = setting(
        default="two_ray",
        doc="two_ray: the ground reflects, so that power falls with the fourth power of distance at long "
        "range; none: no ground",
    )
    air_to_ground: Land = setting(
        default="none",
        doc="land use between a radio near the ground and one above; none: all links are alike",
    )
    ground_height: float = setting(
        default=5.0,
        unit="m",
        doc="height above ground below which a radio counts as near the ground, for air_to_ground",
        minimum=0.0,
    )


@record
class Packet:
    """A packet, and when it is lost."""

    model: Literal["fsk", "bpsk", "threshold", "probability"] = setting(
        default="fsk",
        doc="law of the packet error rate: of a modulation, of a receiver's threshold, or of distance alone",
    )
    bytes: int = setting(default=60, doc="length on the air, with headers and checksums", minimum=1, maximum=65535)
    snr50_db: Array = parameter(
        default=10.0, unit="dB", doc="model 'threshold': signal-to-noise ratio at which half of the packets are lost"
    )
    width_db: Array = parameter(default=0.5, unit="dB", doc="model 'threshold': width of the transition", above=0.0)
    range: Array = parameter(default=300.0, unit="m", doc="model 'probability': longest range", above=0.0)
    probability: Array = parameter(
        default=1.0,
        unit="",
        doc="model 'probability': chance that a packet is received within range",
        minimum=0.0,
        maximum=1.0,
    )
    capture_db: Array = parameter(
        default=6.0, unit="dB", doc="margin over the sum of all other packets at which a packet is still received"
    )
    preamble: float = setting(default=0.0, unit="s", doc="time on the air before the first byte", minimum=0.0)
    spreading_factor: int = setting(
        default=0,
        doc="spreading factor of LoRa, which sets the time of a packet on the air; 0: no LoRa",
        minimum=0,
        maximum=12,
    )


@record
class Mac:
    """Access to the channel. Every vehicle sends at most one packet in a period."""

    type: Literal["ideal", "tdma", "aloha", "csma"] = setting(
        default="ideal",
        doc="ideal: all at once, without collisions; tdma: each in its slot; aloha: at any time; csma: after listening",
    )
    period: float = setting(default=0.2, unit="s", doc="period of the exchange, a multiple of the time step", above=0.0)
    slots: int = setting(default=20, doc="tdma: slots in a period; vehicle i has slot i modulo slots", minimum=1)
    queue: int = setting(
        default=4, doc="length of a vehicle's send queue; the oldest messages are dropped first", minimum=1, maximum=64
    )
    sense: Literal["packet", "noise"] = setting(
        default="packet",
        doc="transmissions that csma defers to; packet: those it can receive; noise: those above the noise",
    )
    attempts: int = setting(
        default=4, doc="csma: attempts in a period before a message waits for the next one", minimum=1, maximum=16
    )


@record
class Delay:
    """Latency in addition to the time on the air."""

    fixed: float = setting(default=0.005, unit="s", doc="processing time at both ends", minimum=0.0)
    jitter: float = setting(
        default=0.002, unit="s", doc="median of a further random latency, log-normal with sigma 0.5", minimum=0.0
    )


@record
class InboxSize:
    """Messages that a vehicle keeps, and the search for vehicles that it could receive."""

    size: int = setting(
        default=8, doc="number of senders for which the newest message is kept (K)", minimum=1, maximum=64
    )
    forget: float = setting(default=2.0, unit="s", doc="age at which a message is dropped", above=0.0)
    reach: Array = parameter(
        default=300.0, unit="m", doc="largest distance at which other vehicles are searched", above=0.0
    )
    candidates: int = setting(
        default=24, doc="number of nearest vehicles within reach that can be received", minimum=1, maximum=256
    )


# A preset gives defaults; its sources are in docs/explanation/models/radio.md.
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
