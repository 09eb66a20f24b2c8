"""The full Dryden turbulence beside JSBSim's, an independent implementation, and the closed forms of MIL-F-8785C.

The computation is ``qrsim validate``'s, in more cases and over longer series.
"""

from __future__ import annotations

from typing import Any

from evidence import IMAGES
from qrsim.studies.validate.jsbsim_gusts import INSTALL, TYPES, jsbsim_theory
from qrsim.studies.validate.spectra import CASES, COMPONENTS, DT, SEVERITY, SPAN, closed_form
from qrsim.studies.validate.statistics import family_summary
from qrsim.studies.validate.turbulence import spectra_figure, study_case

__all__ = ["CASES", "COMPONENTS", "DOC", "INSTALL", "SEED", "TYPES", "closed_form", "jsbsim_theory", "run"]

DOC = "variances and spectra of the full Dryden turbulence, JSBSim's and the closed forms of MIL-F-8785C"
# The day of MIL-F-8785C; each case counts on from it.
SEED = 19801105
FIGURE = IMAGES / "turbulence.png"


def run(full: bool) -> dict[str, Any]:
    """Return variances and spectra of every source; the full form has more cases and draws docs/images/turbulence.png.

    Raises:
        RunError: no jsbsim.
    """
    steps = 1_048_576 if full else 131_072
    cases = CASES if full else {"low": CASES["low"]}
    results: dict[str, Any] = {}
    for number, (name, case) in enumerate(cases.items()):
        results[name], series, levels = study_case(case, steps, SEED + number, ("ours", *TYPES))
        if full and name == "low":
            FIGURE.parent.mkdir(parents=True, exist_ok=True)
            spectra_figure(case, series, levels).savefig(FIGURE, dpi=110)
    return {"time_step": DT, "span": SPAN, "severity": SEVERITY, "steps": steps, **family_summary(results), **results}
