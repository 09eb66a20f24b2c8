"""The full Dryden turbulence beside JSBSim's, an independent implementation, and the closed forms of MIL-F-8785C.

JSBSim has two models of the Dryden spectra, both after Yeager, NASA CR-1998-206937:

- type 3, ttMilspec: the recursions of MIL-STD-1797A. Euler steps, and v and w are of first order too, with half the
  time constant: it has the standard's variance and low frequencies, but not its form.
- type 4, ttTustin: the filters of MIL-F-8785C by the bilinear transform; this is the second-order model.

A body of JSBSim's is held at one height and speed by switching its integrators off; turbulence is stepped as in a
flight. Both recursions are also put down here as difference equations, whose variances and spectra are exact, so
that what separates JSBSim from the standard can be told from chance. Its roll gust is of another form (1797A's
sigma_p and L_p) and is left out.
"""

from __future__ import annotations

import itertools
import math
import tempfile
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import signal

from evidence.noise import against, judge
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.errors import RunError
from qrsim.models.dryden import Dryden, DrydenState, dryden_scales
from qrsim.models.wind import FEET_PER_METRE

DOC = "variances and spectra of the full Dryden turbulence, JSBSim's and the closed forms of MIL-F-8785C"
# The day of MIL-F-8785C; each case counts on from it.
SEED = 19801105
INSTALL = "install it with 'python -m pip install jsbsim'"
FIGURE = Path(__file__).resolve().parents[1] / "docs" / "images" / "turbulence.png"

DT = 0.02
SPAN = 2.0
SEVERITY = 3
SEGMENT = 4096
VEHICLES = 16
COMPONENTS = ("u", "v", "w", "q", "r")
TYPES = {"jsbsim_type_3": 3, "jsbsim_type_4": 4}
# Of third octaves [rad/s], as far as omega T = 1.
LOWEST_OMEGA, BANDS = 0.25, 23

Floats = np.ndarray[Any, np.dtype[np.floating[Any]]]


class Case(NamedTuple):
    """Height [m], airspeed [m/s] and wind 20 ft above the ground [m/s]; gusts are small against the airspeed.

    JSBSim's airspeed includes the gusts, so that large ones would move its own time constants about.
    """

    height: float
    airspeed: float
    speed_20ft: float


CASES = {"low": Case(15.24, 20.0, 0.5), "middle": Case(152.4, 30.0, 0.5), "high": Case(914.4, 75.0, 0.5)}

# A body without forces; JSBSim takes the span of the angular gusts from it.
BODY = f"""<?xml version="1.0"?>
<fdm_config name="held" version="2.0" release="ALPHA">
  <metrics>
    <wingarea unit="M2"> 1 </wingarea> <wingspan unit="M"> {SPAN} </wingspan> <chord unit="M"> 1 </chord>
    <location name="AERORP" unit="M"> <x> 0 </x> <y> 0 </y> <z> 0 </z> </location>
    <location name="EYEPOINT" unit="M"> <x> 0 </x> <y> 0 </y> <z> 0 </z> </location>
    <location name="VRP" unit="M"> <x> 0 </x> <y> 0 </y> <z> 0 </z> </location>
  </metrics>
  <mass_balance>
    <ixx unit="KG*M2"> 1 </ixx> <iyy unit="KG*M2"> 1 </iyy> <izz unit="KG*M2"> 1 </izz> <emptywt unit="KG"> 1 </emptywt>
    <location name="CG" unit="M"> <x> 0 </x> <y> 0 </y> <z> 0 </z> </location>
  </mass_balance>
  <ground_reactions/> <propulsion/> <flight_control name="none"/>
  <aerodynamics> <axis name="LIFT"/> <axis name="ROLL"/> </aerodynamics>
</fdm_config>
"""


def jsbsim_series(case: Case, kind: int, steps: int, seed: int) -> Floats:
    """Return (5, steps) of u, v, w [m/s], q, r [rad/s] of JSBSim's turbulence, at the body's fixed height and speed.

    Raises:
        RunError: no jsbsim, or it does not hold the body.
    """
    try:
        import jsbsim
    except ImportError as error:
        raise RunError(f"no JSBSim to compare with; {INSTALL}") from error
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "held").mkdir()
        (Path(folder) / "held" / "held.xml").write_text(BODY, encoding="utf-8")
        # No banner on the terminal.
        jsbsim.FGJSBBase().debug_lvl = 0
        body = jsbsim.FGFDMExec(None)
        body.set_debug_level(0)
        if not body.load_model_with_paths("held", folder, folder, folder, True):
            raise RunError("JSBSim did not load the body that this study holds")
    body.set_dt(DT)
    body["simulation/randomseed"] = seed
    # On the equator, level, heading north: the gusts' axes are then north, east and down.
    body["ic/h-sl-ft"] = case.height * FEET_PER_METRE
    body["ic/u-fps"] = case.airspeed * FEET_PER_METRE
    body.run_ic()
    for integrator in ("rate/rotational", "rate/translational", "position/rotational", "position/translational"):
        body[f"simulation/integrator/{integrator}"] = 0
    body["atmosphere/turb-type"] = kind
    body["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = case.speed_20ft * FEET_PER_METRE
    body["atmosphere/turbulence/milspec/severity"] = SEVERITY
    names = [f"atmosphere/turb-{axis}-fps" for axis in ("north", "east", "down")]
    names += [f"atmosphere/{axis}-turb-rad_sec" for axis in ("q", "r")]
    manager = body.get_property_manager()
    nodes = [manager.get_node(name) for name in names]
    series = np.empty((steps, len(names)))
    for row in series:
        body.run()
        row[:] = [node.get_double_value() for node in nodes]
    if abs(body["position/h-sl-ft"] / FEET_PER_METRE - case.height) > 1e-3 * case.height:
        raise RunError("JSBSim's body did not stay at its height")
    series[:, :3] /= FEET_PER_METRE
    return np.asarray(series.T)


@partial(jax.jit, static_argnums=1)
def _simulate(turbulence: Dryden, steps: int, key: Key, height: jax.Array, airspeed: jax.Array) -> jax.Array:
    ids, zero = jnp.arange(height.size, dtype=jnp.uint32), jnp.zeros_like(height)
    like = jnp.zeros((), height.dtype)
    stream, still = key.stream("gust", ids), Vec3(zero, zero, zero)

    def tick(state: DrydenState, now: jax.Array) -> tuple[DrydenState, jax.Array]:
        state = turbulence.step(state, Draw(stream, now, like), height, Vec3(airspeed, zero, zero), still, DT)
        gust, rates = turbulence.gust_ned(state, height), turbulence.gust_rates_ned(state, height)
        return state, jnp.stack([gust.x, gust.y, gust.z, rates.y, rates.z])

    start = turbulence.init(Draw(key.stream("start", ids), jnp.uint32(0), like))
    return jax.lax.scan(tick, start, jnp.arange(steps, dtype=jnp.uint32))[1]


def our_series(case: Case, steps: int, seed: int) -> Floats:
    """Return (5, VEHICLES, steps / VEHICLES) of the same quantities from this project's component, in float32."""
    # With the wind from the south, wind axes are north, east and down.
    turbulence = cast(Dryden(case.speed_20ft, math.pi, SPAN, SEVERITY), np.float32)  # type: ignore[arg-type]
    like = np.ones(VEHICLES, np.float32)
    series = _simulate(turbulence, steps // VEHICLES, Key.root(seed), case.height * like, case.airspeed * like)
    return np.moveaxis(np.asarray(series, np.float64), 0, -1)


def scales(case: Case) -> tuple[Floats, Floats]:
    """Return (3,) lengths [m] and standard deviations [m/s] of u, v, w, in float64."""
    with jax.enable_x64(True):
        lengths, sigmas = dryden_scales(jnp.asarray([case.height]), jnp.asarray(case.speed_20ft), SEVERITY)
        return np.asarray(lengths.stack())[0], np.asarray(sigmas.stack())[0]


def closed_form(case: Case, omega: Floats) -> Floats:
    """Return the two-sided densities (5, k) of MIL-F-8785C; over 2 pi they integrate to the variances."""
    lengths, sigmas = scales(case)
    tau, variance = (lengths / case.airspeed)[:, None], np.square(sigmas)[:, None]
    square = np.square(omega * tau)
    u = 2.0 * variance[0] * tau[0] / (1.0 + square[0])
    v, w = (variance * tau * (1.0 + 3.0 * square) / np.square(1.0 + square))[1:]
    q, r = (
        np.square(omega / case.airspeed) / (1.0 + np.square(omega * spans * SPAN / (math.pi * case.airspeed))) * gust
        for spans, gust in ((4.0, w), (3.0, v))
    )
    return np.stack([u, v, w, q, r])


def sampled_closed_form(case: Case, omega: Floats) -> Floats:
    """Return the densities (5, k) of samples of the closed form every DT: the sum over aliases, far ones integrated."""
    images, folded = 20, 2.0 * math.pi / DT
    total = sum(closed_form(case, omega + folded * image) for image in range(-images, images + 1))
    edge = folded * (images + 0.5)
    return np.asarray(total + 2.0 * closed_form(case, np.array([edge])) * edge / folded)


Filter = tuple[list[float], list[float]]


def _second_order_tustin(tau: float, c: float) -> Filter:
    """Yeager's eq. 20."""
    omega, root = 1.0 / tau, math.sqrt(3.0)
    scale = math.sqrt(3.0 * omega / DT) / (omega + c) ** 2
    top = [scale * (c + omega / root), scale * 2.0 * omega / root, scale * (omega / root - c)]
    return top, [1.0, 2.0 * (omega**2 - c**2) / (omega + c) ** 2, ((omega - c) / (omega + c)) ** 2]


def _recursions(case: Case, kind: int) -> list[Filter]:
    """Return numerators and denominators in 1/z of JSBSim's recursions: u, v, w per sigma, q per w, r per v."""
    tau_u, tau_v, tau_w = scales(case)[0] / case.airspeed
    lags = [spans * SPAN / (math.pi * case.airspeed) for spans in (4.0, 3.0)]
    if kind == 3:
        gusts = [(n * DT / tau, math.sqrt(2.0 * n * DT / tau)) for n, tau in ((1, tau_u), (2, tau_v), (2, tau_w))]
        per_span = [1.0 / (lag * case.airspeed) for lag in lags]
        return [([gain], [1.0, x - 1.0]) for x, gain in gusts] + [
            ([gain, -gain], [1.0, DT / lag - 1.0]) for gain, lag in zip(per_span, lags, strict=True)
        ]
    # The constant of the bilinear transform, matched to u's pole for v and w as well.
    c = 1.0 / (tau_u * math.tan(DT / (2.0 * tau_u)))
    gain = math.sqrt(2.0 * tau_u / DT) / (1.0 + c * tau_u)
    filters: list[Filter] = [([gain, gain], [1.0, (1.0 - c * tau_u) / (1.0 + c * tau_u)])]
    filters += [_second_order_tustin(tau, c) for tau in (tau_v, tau_w)]
    for lag in lags:
        own = 1.0 / (lag * math.tan(DT / (2.0 * lag)))
        gain = own / (case.airspeed * (1.0 + own * lag))
        filters.append(([gain, -gain], [1.0, (1.0 - own * lag) / (1.0 + own * lag)]))
    return filters


def jsbsim_theory(case: Case, kind: int, omega: Floats) -> Floats:
    """Return the densities (5, k) that JSBSim's recursions have, driven by independent standard normals."""
    unit = np.exp(-1j * omega * DT)
    power = [
        np.square(np.abs(np.polyval(top[::-1], unit) / np.polyval(bottom[::-1], unit)))
        for top, bottom in _recursions(case, kind)
    ]
    u, v, w = DT * np.square(scales(case)[1])[:, None] * np.stack(power[:3])
    return np.stack([u, v, w, power[3] * w, power[4] * v])


def welch(series: Floats) -> tuple[Floats, Floats]:
    """Return frequencies [rad/s] and two-sided densities (5, k) of series (5, ..., steps), without the mean's bin."""
    frequency, density = signal.welch(series, 1.0 / DT, nperseg=min(SEGMENT, series.shape[-1]), detrend=False, axis=-1)
    density = density.reshape(len(COMPONENTS), -1, frequency.size).mean(axis=1) / 2.0
    return 2.0 * math.pi * frequency[1:-1], density[:, 1:-1]


def band_levels(omega: Floats, density: Floats) -> Floats:
    """Return mean densities (5, BANDS) over third octaves up to omega T = 1."""
    edges = LOWEST_OMEGA * 10.0 ** (0.1 * np.arange(BANDS + 1))
    inside = [(omega >= low) & (omega < high) for low, high in itertools.pairwise(edges)]
    return np.stack([density[:, band].mean(axis=1) for band in inside], axis=1)


def compare(series: Floats, theory: Any, case: Case) -> tuple[dict[str, Any], Floats]:
    """Return the statistics of one source, and its level over the closed form [dB] in each band, (5, BANDS).

    Args:
        series: (5, ..., steps).
        theory: densities (5, k) of the source at frequencies (k,).
        case: where it was taken.
    """
    circle = 2.0 * math.pi / DT * np.arange(2**16) / 2**16
    signed = (circle + math.pi / DT) % (2.0 * math.pi / DT) - math.pi / DT
    density, target = theory(signed), sampled_closed_form(case, signed)
    omega, estimate = welch(series)
    levels = band_levels(omega, estimate)
    over_theory, over_closed = (
        10.0 * np.log10(levels / band_levels(omega, form(omega))) for form in (theory, partial(closed_form, case))
    )
    results: dict[str, Any] = {}
    for i, name in enumerate(COMPONENTS):
        expected, wanted = float(np.mean(density[i]) / DT), float(np.mean(target[i]) / DT)
        # The variance of a mean of squares is 2/n times the sum of squared autocovariances (Parseval).
        error = math.sqrt(2.0 * np.mean(np.square(density[i] / DT)) / series[i].size)
        variance = float(np.mean(np.square(series[i])))
        results[name] = {
            "variance": against(variance, expected, error),
            "over_closed_form": variance / wanted,
            "expected_over_closed_form": expected / wanted,
            "rms_db_from_own_theory": float(np.sqrt(np.mean(np.square(over_theory[i])))),
            "largest_db_from_closed_form": float(np.max(np.abs(over_closed[i]))),
        }
    return results, over_closed


def draw_figure(path: Path, case: Case, sources: dict[str, Floats], levels: dict[str, Floats]) -> None:
    """Write the spectra of u, v and w of one case, and below them each source's level over the closed form."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3, sharex=True, sharey="row", height_ratios=(3, 2))
    labels = {"ours": "qrsim, dryden", "jsbsim_type_3": "JSBSim type 3", "jsbsim_type_4": "JSBSim type 4"}
    centres = LOWEST_OMEGA * 10.0 ** (0.1 * (np.arange(BANDS) + 0.5))
    for i, name in enumerate(COMPONENTS[:3]):
        top, bottom = axes[0][i], axes[1][i]
        for source, series in sources.items():
            omega, estimate = welch(series)
            inside = (omega >= LOWEST_OMEGA) & (omega * DT <= 1.0)
            top.loglog(omega[inside], estimate[i, inside] / math.pi, linewidth=0.8, label=labels[source])
            bottom.semilogx(centres, levels[source][i], marker=".", linewidth=0.8)
        fine = np.geomspace(LOWEST_OMEGA, 1.0 / DT, 200)
        top.loglog(fine, closed_form(case, fine)[i] / math.pi, "k--", linewidth=1.0, label="MIL-F-8785C")
        bottom.axhline(0.0, color="k", linestyle="--", linewidth=1.0)
        bottom.set_ylim(-2.5, 2.5)
        top.set_title(f"{name}, {case.height:g} m above ground, {case.airspeed:g} m/s")
        bottom.set_xlabel("angular frequency [rad/s]")
    axes[0][0].set_ylabel("one-sided density [(m/s)$^2$/(rad/s)]")
    axes[1][0].set_ylabel("over the closed form [dB]")
    axes[0][0].legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def study_case(case: Case, steps: int, seed: int = SEED) -> tuple[dict[str, Any], dict[str, Floats], dict[str, Floats]]:
    """Return the statistics, series and levels over the closed form of all three sources in one case."""
    series = {"ours": our_series(case, steps, seed)}
    series |= {name: jsbsim_series(case, kind, steps, seed) for name, kind in TYPES.items()}
    theories: dict[str, Any] = {"ours": partial(sampled_closed_form, case)}
    theories |= {name: partial(jsbsim_theory, case, kind) for name, kind in TYPES.items()}
    results: dict[str, Any] = dict(case._asdict())
    levels = {}
    for name in series:
        results[name], levels[name] = compare(series[name], theories[name], case)
    return results, series, levels


def run(full: bool) -> dict[str, Any]:
    """Return variances and spectra of every source; the full form has more cases and draws docs/images/turbulence.png.

    Raises:
        RunError: no jsbsim.
    """
    steps = 1_048_576 if full else 131_072
    cases = CASES if full else {"low": CASES["low"]}
    results: dict[str, Any] = {}
    for number, (name, case) in enumerate(cases.items()):
        results[name], series, levels = study_case(case, steps, SEED + number)
        if full and name == "low":
            draw_figure(FIGURE, case, series, levels)
    return {"time_step": DT, "span": SPAN, "severity": SEVERITY, "steps": steps, **judge(results), **results}
