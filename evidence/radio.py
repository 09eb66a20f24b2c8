"""Packets that arrive over distance for each preset of the radio, over built-up land, and of pure ALOHA, against their
closed forms.

Two vehicles at each distance, in a network of the preset without shadowing, exchange beacons; what the closed form says
is computed here in double precision, from the data that docs/explanation/models/radio.md names. Bands are of 99 %
(binomial), for all distances of a preset together. The full form draws docs/images/radio_delivery.png.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from evidence import IMAGES
from evidence._pictures import picture
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.models.radio.contracts import STREAMS, Exchange, Outbox, Surfaces
from qrsim.models.radio.network import Network
from qrsim.models.radio.parameters import InboxSize, Mac, Packet, PathLoss
from qrsim.scenarios.scenario import load_scenario

DOC = "delivery against distance of each preset, and pure ALOHA, against their closed forms"
SEED, STEP, CONFIDENCE = 11, 0.02, 0.99
# Frequency [Hz], power [dBm], bandwidth [Hz], rate [bit/s], noise figure [dB], bytes; the law, with its ratio [dB].
DATA: dict[str, tuple[float, float, float, float, float, int, str, float]] = {
    "sik_915": (915e6, 20.0, 250e3, 64e3, 6.0, 60, "fsk", math.nan),
    "xbee_pro_900": (915e6, 17.0, 300e3, 156e3, 6.0, 60, "threshold", 12.13),
    "wifi_2g4": (2437e6, 20.0, 20e6, 6e6, 7.0, 60, "threshold", 10.89),
    "lora_sf7": (868e6, 14.0, 125e3, 5470.0, 6.0, 32, "threshold", -8.6),
    "lora_sf12": (868e6, 14.0, 125e3, 293.0, 6.0, 32, "threshold", -21.1),
}
EXPONENT, WIDTH = 2.2, 0.5
# Heights above the ground [m] of the two that packets are counted between, and of ends of which the reach is computed.
HEIGHT = 30.0
ENDS = {
    "ground_ground": (1.5, 1.5),
    "ground_30m": (1.5, 30.0),
    "10m_10m": (10.0, 10.0),
    "30m_30m": (30.0, 30.0),
    "100m_100m": (100.0, 100.0),
}
# Man-made noise of a residential land above thermal noise: 72.5 - 27.7 lg f [MHz] (P.372).
RESIDENTIAL = (72.5, 27.7)
# Chances of loss at whose distances packets are counted.
LEVELS = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98)
# Between a station on the ground and a vehicle so high above it [m], at so many distances [m]: a and b, and dB beside
# free space (Al-Hourani and others, 2014).
LAND: dict[str, tuple[float, float, float, float]] = {
    "suburban": (4.88, 0.43, 0.1, 21.0),
    "urban": (9.61, 0.16, 1.0, 20.0),
    "dense_urban": (12.08, 0.11, 1.6, 23.0),
    "high_rise": (27.23, 0.08, 2.3, 34.0),
}
ABOVE, OVER = 120.0, "wifi_2g4"
LOADS = (0.05, 0.1, 0.2, 0.5, 1.0)
SENDERS, PERIOD = 25, 0.2
# Packets at each distance, periods of ALOHA at each load.
FULL, SMALL = (200_000, 40_000), (4_000, 1_000)
IMAGE = IMAGES / "radio_delivery.png"

Values = np.ndarray[Any, Any]


def received(preset: str, distance: Any, ends: tuple[float, float] | None = (HEIGHT, HEIGHT)) -> Any:
    """Return the power [dBm] at distances [m], without shadowing, of ends at heights [m]; None: without a ground."""
    frequency, power, *_ = DATA[preset]
    length = np.maximum(distance, 1.0)
    lost = 20.0 * math.log10(4.0 * math.pi * frequency / 299_792_458.0) + 10.0 * EXPONENT * np.log10(length)
    if ends is not None:
        least = 299_792_458.0 / frequency / (2.0 * math.pi * math.sqrt(14.0) / 15.0)
        high = math.hypot(ends[0], least) * math.hypot(ends[1], least)
        lost = np.maximum(lost, 40.0 * np.log10(length) - 20.0 * math.log10(high))
    return power - lost


def received_over(land: str, level: Any) -> Any:
    """Return the power [dBm] of preset OVER between the ground and a height of ABOVE, so far away on the ground [m]."""
    frequency, power, *_ = DATA[OVER]
    a, b, with_sight, without = LAND[land]
    free = 20.0 * np.log10(4.0 * math.pi * np.hypot(level, ABOVE) * frequency / 299_792_458.0)
    chance = 1.0 / (1.0 + a * np.exp(-b * (np.degrees(np.arctan2(ABOVE, level)) - a)))
    return power - free - with_sight * chance - without * (1.0 - chance)


def closed_form(preset: str, distance: Values) -> Values:
    """Return the chance that a packet is lost at distances [m] without shadowing."""
    return lost_at(preset, received(preset, distance))


def lost_at(preset: str, power: Values) -> Values:
    """Return the chance that a packet is lost that is received at powers [dBm]."""
    frequency, _, bandwidth, rate, figure, length, law, half = DATA[preset]
    others = RESIDENTIAL[0] - RESIDENTIAL[1] * math.log10(1e-6 * frequency)
    noise = 10.0 * math.log10(10.0 ** (0.1 * figure) + 10.0 ** (0.1 * others))
    snr = power + 174.0 - 10.0 * math.log10(bandwidth) - noise
    if law == "threshold":
        return 1.0 / (1.0 + np.exp((snr - half) / WIDTH))
    bit = 0.5 * np.exp(-0.5 * 10.0 ** (snr / 10.0) * bandwidth / rate)
    return -np.expm1(8.0 * length * np.log1p(-bit))


def distances(preset: str) -> Values:
    """Return the distances [m] at which the closed form has the levels."""
    many = np.geomspace(10.0, 1e6, 200_001)
    return np.interp(LEVELS, closed_form(preset, many), many)


def network(preset: str, land: str = "none", **parts: Any) -> Network:
    """Return the network of a preset as a scenario has it, without shadowing, for two vehicles."""
    radio = {"preset": preset, "path_loss": {"shadowing_db": 0.0, "waves": 1, "air_to_ground": land}}
    world = load_scenario({"name": "pair", "extends": "free_flight", "world": {"radio": radio}}, quiet=True).world()
    one = InboxSize(size=1, reach=np.float32(1e7), candidates=1)
    built: Any = world.radio
    return replace(built, inbox=cast(one, np.float32), **parts)


def exchanged(radio: Network, north: Any, said: Outbox, periods: int, height: Any = None) -> Any:
    """Return the counts of a network after so many periods of vehicles (n,) along a line [m], at heights [m]."""
    n = north.shape[0]
    key = Key.root(SEED)
    waves = Draw(key.stream("/radio.field", jnp.arange(1, dtype=jnp.uint32)), jnp.int32(0), jnp.float32(0.0))
    zero = jnp.zeros(n)
    down = zero if height is None else -height
    surfaces = Surfaces(Vec3(north, zero, down), jnp.ones(n, bool), height=height)
    ticks = round(radio.mac.period / STEP)
    beacons = replace(said, to=jnp.full(n, -1, jnp.int32)) if radio.beacon else None

    def period(number: Any, state: Any) -> Any:
        tick = number * ticks
        call = Exchange(
            None if radio.beacon else said, beacons, surfaces, np.arange(n, dtype=np.uint32), tick, tick, STEP
        )
        return radio.exchange(state, call)

    return jax.lax.fori_loop(0, periods, period, radio.init(waves, key.streams(STREAMS), north)).counts


def delivery(preset: str, packets: int) -> dict[str, Any]:
    """Return the measured and the computed chance of loss at each distance, and how many are outside of the band."""
    where = distances(preset)
    found = counted(network(preset), where, packets, closed_form(preset, where), (HEIGHT, HEIGHT))
    many = np.geomspace(10.0, 1e6, 200_001)
    reach = {name: np.interp(0.1, lost_at(preset, received(preset, many, ends)), many) for name, ends in ENDS.items()}
    free = np.interp(0.1, lost_at(preset, received(preset, many, None)), many)
    return {
        **found,
        "dbm_10": received(preset, float(where[1])),
        "reach_without_ground": float(free),
        "reach": {name: float(value) for name, value in reach.items()},
    }


def over_land(land: str, packets: int) -> dict[str, Any]:
    """Return the same of links between the ground and the air over built-up land, by the distance on the ground."""
    many = np.geomspace(10.0, 1e6, 200_001)
    where = np.interp(LEVELS, lost_at(OVER, received_over(land, many)), many)
    return counted(network(OVER, land), where, packets, lost_at(OVER, received_over(land, where)), (0.0, ABOVE))


def counted(radio: Network, where: Values, packets: int, law: Values, heights: tuple[float, float]) -> dict[str, Any]:
    """Return the measured and the computed chance of loss at distances [m] of two at heights [m]."""
    said = Outbox(jnp.zeros((radio.size, 2)), jnp.ones(2, bool), jnp.full(2, -1, jnp.int32))
    height = jnp.array(heights, jnp.float32)
    counts = jax.jit(jax.vmap(lambda far: exchanged(radio, jnp.stack([0.0 * far, far]), said, packets // 2, height)))(
        jnp.asarray(where, jnp.float32)
    )
    lost = 1.0 - np.asarray(counts.heard).sum(axis=1) / packets
    each = 1.0 - (1.0 - CONFIDENCE) / len(where)
    low, high = scipy.stats.binom.interval(each, packets, law)
    return {
        "distance": _by_level(where),
        "loss": _by_level(lost),
        "law": _by_level(law),
        "outside": int(np.sum((lost * packets < low) | (lost * packets > high))),
        "largest_difference": float(np.max(np.abs(lost - law))),
    }


def _by_level(values: Values) -> dict[str, float]:
    """Return numbers by the chances of loss that they belong to, in percent."""
    return {f"{100.0 * level:.0f}": float(value) for level, value in zip(LEVELS, values, strict=True)}


def aloha(load: float, periods: int) -> dict[str, float]:
    """Return the part of packets that arrives at one receiver from senders of a load, and exp(-2 load)."""
    air = load * PERIOD / (SENDERS - 1)
    radio = cast(
        Network(
            rate_kbps=8.0 * 60 / air / 1000.0,
            mac=Mac(type="aloha", period=PERIOD),
            beacon=False,
            inbox=InboxSize(size=1, candidates=SENDERS),
            path_loss=PathLoss(shadowing_db=0.0, waves=1),
            packet=Packet(model="probability", range=1e6, capture_db=300.0),
        ),
        np.float32,
    )
    n = SENDERS + 1
    said = Outbox(jnp.zeros((6, n)), jnp.arange(n) < SENDERS, jnp.full(n, SENDERS, jnp.int32))
    counts = jax.jit(lambda north: exchanged(radio, north, said, periods))(jnp.arange(n, dtype=jnp.float32))
    part = float(counts.heard[SENDERS] / np.asarray(counts.sent)[:SENDERS].sum())
    exact = (1.0 - 2.0 * load / (SENDERS - 1)) ** (SENDERS - 1)
    return {"arrives": part, "law": exact, "pure": math.exp(-2.0 * load), "relative": part / exact - 1.0}


def draw(found: dict[str, Any]) -> None:
    """Draw what arrives over distance: laws as lines, measurements as dots."""
    with picture(IMAGE, (7.0, 3.6), dpi=150) as axes:
        for preset, values in found.items():
            far = np.array(list(values["distance"].values()))
            where = np.geomspace(0.3 * far[0], 2.0 * far[-1], 300)
            (line,) = axes.plot(where, 1.0 - closed_form(preset, where), label=preset)
            axes.plot(far, 1.0 - np.array(list(values["loss"].values())), "o", color=line.get_color(), markersize=4)
        axes.set(xscale="log", xlabel="distance [m]", ylabel="part of packets that arrives", ylim=(-0.02, 1.02))


def run(full: bool) -> dict[str, Any]:
    """Return delivery of each preset, and ALOHA at each load; the full form draws the picture."""
    packets, periods = FULL if full else SMALL
    presets = tuple(DATA) if full else ("sik_915", "wifi_2g4")
    found = {preset: delivery(preset, packets) for preset in presets}
    lands = {land: over_land(land, packets) for land in (tuple(LAND) if full else ("urban",))}
    if full:
        draw(found)
    loads = LOADS if full else LOADS[3:4]
    return {
        "confidence": CONFIDENCE,
        "packets": packets,
        "presets": found,
        "lands": lands,
        "outside": sum(values["outside"] for values in (*found.values(), *lands.values())),
        "aloha": {f"{100.0 * load:.0f}": aloha(load, periods) for load in loads},
    }
