"""The turbulence field against the closed forms of isotropic turbulence and of MIL-F-8785C.

What has a closed form in the mean over worlds (correlations, sweep, variances) is tested against it; spectra along
hovering and flying vehicles, rotation and divergence are compared with the standard's or the exact ones. Whether a
vehicle that hovers for two hours meets tones is told by autocorrelations at lags from one minute to one hour.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from tests.models.atmosphere import field_reference as of

from evidence import IMAGES
from evidence._pictures import picture
from qrsim.studies.validate.statistics import against, family_summary, mean_and_error
from qrsim.studies.validate.wind_field import LIFETIME
from qrsim.studies.validate.wind_field import kept as remembered

DOC = "correlations, spectra, rotation and divergence of dryden_field, and what its waves leave out"
# The day on which Batchelor's book appeared is not known; its year, and a day.
SEED = 19530101
FIGURE = IMAGES / "turbulence_field.png"
LINE = FIGURE.with_name("turbulence_line.png")
HEIGHT = 15.0
SEPARATIONS = (1.0, 5.0, 20.0, 100.0)
AXES = ("u", "v", "w")
# A vehicle that hovers in a wind, and one that flies across it [m/s].
CONVECTION, ACROSS = 8.0, 12.0
SPACING, BANDS = 1.0, (8.0, 16.0, 32.0, 64.0, 128.0, 256.0)

# A vehicle that hovers: samples, their spacing [s], lags of autocorrelations [s] and the share of the variance that
# the strongest lines are counted for.
HOVER_SAMPLES, HOVER_SPACING, HOVER_LAGS, HOVER_SHARE = 28800, 0.25, (60.0, 3600.0), 0.9

Floats = np.ndarray[Any, np.dtype[np.float64]]


def run(full: bool) -> dict[str, Any]:
    """Return every comparison; the full form has more worlds and draws docs/images/turbulence_field.png."""
    worlds = 400 if full else 100
    pairs = two_points(worlds, 50 if full else 20)
    levels = {str(h): spectra(h, 64 if full else 24) for h in ((5, 15, 100, 300) if full else (15,))}
    every = [
        ratio
        for height in levels.values()
        for each in height.values()
        for bands in each.values()
        for ratio in bands.values()
    ]
    if full:
        draw_figure(worlds)
        draw_line()
    return {
        "kept": kept(),
        "wind_over_20_m": {str(h): math.log(h / 0.3048 / 0.15) / math.log(20.0 / 0.3048 / 0.15) for h in (5, 60, 120)},
        "two_points": pairs,
        "lifetime": aged(worlds),
        "hover": hovering(32 if full else 4),
        "spectra": {"smallest": min(every), "largest": max(every), **levels},
        "rotation": {str(h): rotation(h, 20 if full else 5) for h in (5, 15, 60, 700)},
        **family_summary(pairs),
    }


def kept() -> dict[str, Any]:
    """Return the share of the variance that the waves have, by form and height [m], in closed form."""
    found: dict[str, Any] = {}
    for spectrum, high in (("dryden", 1750.0), ("von_karman", 2500.0)):
        found[spectrum] = {}
        for height in (3, 5, 10, 15, 30, 60, 120, 700):
            scales = of.mil(float(height), high_ft=high)
            shares = [
                float(np.mean(np.sum(of.shells(float(length), spectrum=spectrum)[1], axis=1)))
                for length in (scales.length_h, scales.length_w)
            ]
            found[spectrum][str(height)] = {"horizontal": shares[0], "vertical": shares[1]}
    return found


def places(count: int, height: float = HEIGHT, spread: float = 2000.0, seed: int = SEED) -> Floats:
    """Return places (n, 3) at a height, spread over a square."""
    flat = np.random.default_rng(seed).uniform(-spread, spread, (count, 2))
    return np.column_stack([flat, np.full(count, -height)])


def two_points(worlds: int, pairs: int) -> dict[str, Any]:
    """Compare products of gusts at two points with the closed forms of the mean over worlds, one statistic each.

    Along and across a horizontal separation r [m] at 15 m, of horizontal gusts; a vertical one of down gusts across;
    variances; and what must be zero: horizontal with vertical gusts, and the helicity of two heights.
    """
    turbulence, scales = of.component(), of.mil(HEIGHT)
    length, sigma = float(scales.length_h), float(scales.sigma_h)
    shells_h, shells_w = of.shells(length, dilations=32), of.shells(float(scales.length_w), dilations=32)
    here, way = places(pairs), np.random.default_rng(SEED + 1).uniform(0.0, 2.0 * np.pi, pairs)
    n, t = (np.column_stack([c, s, 0.0 * c]) for c, s in ((np.cos(way), np.sin(way)), (-np.sin(way), np.cos(way))))
    first, _ = of.sampled(turbulence, worlds, here)
    found: dict[str, Any] = {}

    def add(name: str, products: Floats, expected: float, standard: float | None = None) -> None:
        mean, error = mean_and_error(products.mean(axis=1))
        found[name] = against(float(mean), expected, float(error)) | {"standard_error": float(error)}
        if standard is not None:
            found[name]["standard"] = standard

    def part(gust: Floats, axis: Floats) -> Floats:
        return np.asarray(np.einsum("wni,ni->wn", gust, axis))

    for r in SEPARATIONS:
        second, _ = of.sampled(turbulence, worlds, here + r * n)
        f, g = (float(form(*shells_h, [r])[0]) for form in (of.shell_along, of.shell_across))
        down = float(of.shell_across(*shells_w, [r])[0])
        lengths = (float(of.along(r, length)), float(of.across(r, length)))
        add(f"along_{r:g}_m", part(first, n) * part(second, n) / sigma**2, f, lengths[0])
        add(f"across_{r:g}_m", part(first, t) * part(second, t) / sigma**2, g, lengths[1])
        vertical = first[:, :, 2] * second[:, :, 2] / float(scales.sigma_w) ** 2
        add(f"vertical_{r:g}_m", vertical, down, float(of.across(r, float(scales.length_w))))
    size = [sigma, sigma, float(scales.sigma_w)]
    for axis, name in enumerate(AXES):
        share = np.mean(np.sum((shells_w if axis == 2 else shells_h)[1], axis=1))
        add(f"variance_{name}", (first[:, :, axis] / size[axis]) ** 2, float(share), 1.0)
    add("horizontal_vertical", part(first, n) * first[:, :, 2] / (sigma * size[2]), 0.0, 0.0)
    above, _ = of.sampled(turbulence, worlds, here - np.array([0.0, 0.0, 2.0]))
    add("helicity_2_m", first[:, :, 0] * above[:, :, 1] / sigma**2, 0.0, 0.0)
    return found


def aged(worlds: int) -> dict[str, Any]:
    """Return the correlation of gusts with earlier ones, in the frame that moves with the field."""
    turbulence, here, found = of.component(convection_ned=[0.0, 0.0]), places(20), {}
    first, _ = of.sampled(turbulence, worlds, here)
    for time in (2.0, 5.0, 20.0, 60.0):
        later, _ = of.sampled(turbulence, worlds, here, time)
        value = float((first * later).sum() / (first**2).sum())
        found[f"after_{time:g}_s"] = {"value": value, "expected": float(remembered(time / LIFETIME))}
    return found


def hovering(worlds: int) -> dict[str, Any]:
    """Return the tones in the gusts at vehicles that hover for two hours, one in each world.

    Of the field, of the frozen field, and of Gaussian noise with the standard's spectra: for gusts along the wind,
    across it and down, the largest autocorrelation at HOVER_LAGS and the number of lines of the spectrum that have
    HOVER_SHARE of the variance, the median and the largest or least over the worlds.
    """
    time = np.arange(HOVER_SAMPLES) * HOVER_SPACING
    here, found = np.tile([0.0, 0.0, -HEIGHT], (HOVER_SAMPLES, 1)), {}
    speed = of.SPEED_20FT * math.log(20.0 / of.FOOT / 0.15) / math.log(20.0 / 0.15)
    for name in ("lifetime", "frozen", "noise"):
        if name == "noise":
            gust = noise(worlds, speed)
        else:
            turbulence = of.component(evolution=name, convection_ned=[speed, 0.0])
            gust = of.sampled(turbulence, worlds, here, time)[0].swapaxes(1, 2)
        peaks, lines = tones(gust)
        found[name] = {
            axis: {
                "largest": {"median": float(np.median(peaks[:, i])), "most": float(peaks[:, i].max())},
                "lines": {"median": int(np.median(lines[:, i])), "least": int(lines[:, i].min())},
            }
            for i, axis in enumerate(AXES)
        }
    return found


def noise(worlds: int, speed: float) -> Floats:
    """Return Gaussian gusts (W, 3, n) with the standard's spectra at a speed [m/s], of unit variance at all times."""
    rng, scales, samples = np.random.default_rng(SEED), of.mil(HEIGHT), 4 * HOVER_SAMPLES
    o = 2.0 * np.pi * np.fft.rfftfreq(samples, HOVER_SPACING) / speed
    forms = (
        of.spectrum_along(o, float(scales.length_h)),
        of.spectrum_across(o, float(scales.length_h)),
        of.spectrum_across(o, float(scales.length_w)),
    )
    shape = (worlds, 3, len(o))
    lines = np.sqrt(np.array(forms)) * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    return np.asarray(np.fft.irfft(lines)[..., :HOVER_SAMPLES])


def tones(gust: Floats) -> tuple[Floats, Floats]:
    """Return the largest autocorrelations (W, 3) of gusts (W, 3, n) at HOVER_LAGS, and their numbers of lines."""
    about = gust - gust.mean(axis=-1, keepdims=True)
    count = about.shape[-1]
    power = np.abs(np.fft.rfft(about, 2 * count)) ** 2
    lags = np.fft.irfft(power)[..., :count] * (count / (count - np.arange(count)))
    first, last = (round(lag / HOVER_SPACING) for lag in HOVER_LAGS)
    peaks = np.abs(lags[..., first : last + 1]).max(axis=-1) / lags[..., 0]
    share = np.cumsum(np.sort(np.abs(np.fft.rfft(about)) ** 2, axis=-1)[..., ::-1], axis=-1)
    return peaks, np.sum(share < HOVER_SHARE * share[..., -1:], axis=-1) + 1


def spectra(height: float, worlds: int) -> dict[str, Any]:
    """Return mean spectra over the standard's in octaves of wavelength, of u, v, w at a vehicle; hover and flight."""
    turbulence = of.component(convection_ned=[CONVECTION, 0.0])
    scales = of.mil(height)
    found: dict[str, Any] = {}
    for name, velocity in (("hover", np.zeros(3)), ("flight", np.array([0.0, ACROSS, 0.0]))):
        through = velocity - np.array([CONVECTION, 0.0, 0.0])
        speed = float(np.linalg.norm(through))
        along = through / speed
        time = np.arange(4096) * SPACING / speed
        gust, _ = of.sampled(turbulence, worlds, time[:, None] * velocity + np.array([0.0, 0.0, -height]), time)
        across = np.array([-along[1], along[0], 0.0])
        parts = (gust @ along, gust @ across, gust[:, :, 2])
        window = np.hanning(len(time))
        o = 2.0 * np.pi * np.fft.rfftfreq(len(time), SPACING)
        found[name] = {}
        for axis, part, form in zip(AXES, parts, (of.spectrum_along, *(of.spectrum_across,) * 2), strict=True):
            length = float(scales.length_w if axis == "w" else scales.length_h)
            sigma = float(scales.sigma_w if axis == "w" else scales.sigma_h)
            power = np.mean(np.abs(np.fft.rfft(part * window, axis=1)) ** 2, axis=0)
            density = power * SPACING / (np.pi * np.sum(window**2))
            found[name][axis] = {}
            for low, high in itertools.pairwise(BANDS):
                inside = (o > 2.0 * np.pi / high) & (o <= 2.0 * np.pi / low)
                ratio = density[inside].mean() / (sigma**2 * form(o[inside], length)).mean()
                found[name][axis][f"{low:g}_{high:g}_m"] = float(ratio)
    return found


def rotation(height: float, worlds: int) -> dict[str, Any]:
    """Return how the rates follow half the exact curl, and the divergence over the gradient, root mean squares."""
    turbulence, here = of.component(), places(200, height)
    rates, exact, divergence, size = [], [], 0.0, 0.0
    for world in range(worlds):
        drawn = of.draw(turbulence, SEED % 2**31, world)
        slope = of.reference(turbulence, drawn, here)[1]
        exact.append(of.half_curl(slope))
        rates.append(of.gust(turbulence, drawn, here)[1])
        divergence += float(np.sum(np.trace(slope, axis1=1, axis2=2) ** 2))
        size += float(np.sum(slope**2))
    got, want = np.concatenate(rates), np.concatenate(exact)
    return {
        "divergence_over_gradient": math.sqrt(divergence / size),
        **{
            name: {
                "correlation": float(np.corrcoef(got[:, i], want[:, i])[0, 1]),
                "rms_rad_s": float(got[:, i].std()),
                "exact_rms_rad_s": float(want[:, i].std()),
            }
            for i, name in enumerate("pqr")
        },
    }


def draw_figure(worlds: int) -> None:
    """Draw correlations against distance: the field's, the closed forms, and independent gusts."""
    turbulence, scales = of.component(), of.mil(HEIGHT)
    r = np.geomspace(0.5, 150.0, 24)
    here = places(20)
    first, _ = of.sampled(turbulence, worlds, here)
    rows = []
    for separation in r:
        second, _ = of.sampled(turbulence, worlds, here + np.array([separation, 0.0, 0.0]))
        rows.append((first * second).mean(axis=(0, 1)) / (first**2).mean(axis=(0, 1)))
    found = np.array(rows)
    with picture(FIGURE, (7.0, 4.2)) as axes:
        h, w = float(scales.length_h), float(scales.length_w)
        curves = (
            ("along the line of two vehicles", 0, of.along(r, h), "tab:blue"),
            ("across it, horizontal", 1, of.across(r, h), "tab:orange"),
            ("across it, vertical", 2, of.across(r, w), "tab:green"),
        )
        for label, axis, closed, colour in curves:
            axes.semilogx(r, closed, color=colour, lw=1.2)
            axes.semilogx(r, found[:, axis], "o", ms=4, color=colour, label=label)
        axes.axhline(0.0, color="0.4", lw=1.2, ls="--", label="gusts of each vehicle's own (dryden)")
        axes.set_xlabel("distance of two vehicles [m]")
        axes.set_ylabel("correlation of their gusts")
        axes.set_title(
            f"dryden_field, {HEIGHT:g} m above ground: lines are closed forms, dots {worlds} worlds", fontsize=10
        )


def draw_line(apart: float = 10.0, vehicles: int = 5) -> None:
    """Draw the gusts of hovering vehicles in a line down the wind: each meets what the one before met, r/U later."""
    turbulence, time = of.component(convection_ned=[CONVECTION, 0.0]), np.arange(0.0, 40.0, 0.1)
    with picture(LINE, (7.5, 4.2)) as axes:
        begun = 28.0
        for i in range(vehicles):
            gust, _ = of.sampled(turbulence, 1, np.tile([apart * i, 0.0, -HEIGHT], (len(time), 1)), time)
            axes.plot(time, 4.0 * i + gust[0, :, 0], color=f"C{i}", lw=1.0)
            axes.axhline(4.0 * i, color="0.8", lw=0.6, zorder=0)
        axes.plot(
            begun + apart * np.arange(vehicles) / CONVECTION,
            4.0 * np.arange(vehicles),
            "k--",
            lw=1.4,
            label="distance over wind",
        )
        axes.set_yticks(4.0 * np.arange(vehicles), [f"{apart * i:g} m" for i in range(vehicles)])
        axes.set_xlabel("time [s]")
        axes.set_ylabel("place down the wind")
        title = f"Gusts along a wind of {CONVECTION:g} m/s at {vehicles} hovering vehicles; 4 m/s from line to line"
        axes.set_title(title, fontsize=10)
        axes.legend(frameon=False, fontsize=9, loc="upper right")
