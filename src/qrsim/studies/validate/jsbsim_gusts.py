"""JSBSim's turbulence, an independent implementation: its series, and the exact densities of its recursions.

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

import importlib.util
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import RunError
from qrsim.models.atmosphere.wind import FEET_PER_METRE
from qrsim.studies.validate.spectra import DT, SEVERITY, SPAN, Case, scales

INSTALL = "install it with 'python -m pip install jsbsim'"
TYPES = {"jsbsim_type_3": 3, "jsbsim_type_4": 4}

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


def is_installed() -> bool:
    """Return whether the package JSBSim is installed."""
    return importlib.util.find_spec("jsbsim") is not None


def jsbsim_series(case: Case, kind: int, steps: int, seed: int) -> Floats:
    """Simulate gusts u, v, w [m/s], q, r [rad/s] (5, steps) by JSBSim's turbulence ``kind`` at fixed height and speed.

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
    nodes: Any = [manager.get_node(name) for name in names]
    series = np.empty((steps, len(names)))
    for row in series:
        body.run()
        row[:] = [node.get_double_value() for node in nodes]
    if abs(body["position/h-sl-ft"] / FEET_PER_METRE - case.height) > 1e-3 * case.height:
        raise RunError("JSBSim's body did not stay at its height")
    series[:, :3] /= FEET_PER_METRE
    return np.asarray(series.T)


Filter = tuple[list[float], list[float]]


def _second_order_tustin(tau: float, c: float) -> Filter:
    """Return numerator and denominator in 1/z of JSBSim's filter for v and w (Yeager's eq. 20)."""
    omega, root = 1.0 / tau, math.sqrt(3.0)
    scale = math.sqrt(3.0 * omega / DT) / (omega + c) ** 2
    top = [scale * (c + omega / root), scale * 2.0 * omega / root, scale * (omega / root - c)]
    return top, [1.0, 2.0 * (omega**2 - c**2) / (omega + c) ** 2, ((omega - c) / (omega + c)) ** 2]


def _recursions(case: Case, kind: int) -> list[Filter]:
    """Return (numerator, denominator) in 1/z of JSBSim's gust filters: u, v, w per sigma, q per w, r per v."""
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
    """Return exact spectral densities (5, k) of JSBSim's gusts u, v, w, q, r at frequencies (k,) [rad/s]."""
    unit = np.exp(-1j * omega * DT)
    power = [
        np.square(np.abs(np.polyval(top[::-1], unit) / np.polyval(bottom[::-1], unit)))
        for top, bottom in _recursions(case, kind)
    ]
    u, v, w = DT * np.square(scales(case)[1])[:, None] * np.stack(power[:3])
    return np.stack([u, v, w, power[3] * w, power[4] * v])
