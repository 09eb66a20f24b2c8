"""The von Karman form of the field beside boxes of hipersim, DTU's generator of Mann's turbulence, without shear.

hipersim asks for wetb, and that for numba and much else that a box of turbulence does not need: it is no dependency.
Its boxes take half a minute, so what they have is written down here, and the nightly tests generate them again.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import pytest
from tests.models.atmosphere import field_reference as field

INSTALL = "install it with 'python -m pip install --no-deps hipersim==0.1.22 tqdm'"

Floats = np.ndarray[Any, Any]
# At 10 ft the standard's horizontal length is 10 ft/(0.177 + 0.00823)^1.2 = 23.05 m; Mann's is 1.339 times that.
HEIGHT, LENGTH, MANN = 3.048, 23.05, 30.87
STEP, SEPARATIONS = 4.0, (8.0, 20.0, 40.0, 60.0)
# Along and across, means over boxes of seeds 1 and 2, by hipersim 0.1.22.
OF_BOXES = np.array(
    [[4.28868113, 2.64810374, 1.25891718, 0.61001793], [3.53292474, 1.63850468, 0.35805184, -0.02700213]]
)


def of_a_box(seed: int) -> tuple[Floats, Floats]:
    """Return products of velocities along and across SEPARATIONS, means over a box of 2 km by 512 m by 512 m."""
    from hipersim import MannTurbulenceField

    box = MannTurbulenceField.generate(
        alphaepsilon=1.0,
        L=MANN,
        Gamma=0,
        Nxyz=(512, 128, 128),
        dxyz=(STEP,) * 3,
        seed=seed,
        HighFreqComp=0,
        double_xyz=(False, True, True),
    )
    velocity = np.asarray(box.uvw, np.float64)

    def product(component: int, axis: int, steps: int) -> float:
        values = np.moveaxis(velocity[component], axis, 0)
        return float(np.mean(values[:-steps] * values[steps:]))

    steps = [round(r / STEP) for r in SEPARATIONS]
    along = [np.mean([product(i, i, n) for i in range(3)]) for n in steps]
    across = [np.mean([product(i, j, n) for i in range(3) for j in range(3) if i != j]) for n in steps]
    return np.array(along), np.array(across)


def of_the_field() -> tuple[Floats, Floats]:
    """Return the same of the component, over 400 worlds and 60 pairs of places."""
    turbulence = field.component(spectrum="von_karman")
    numbers = np.random.default_rng(4)
    here = np.column_stack([numbers.uniform(-2000.0, 2000.0, (60, 2)), np.full(60, -HEIGHT)])
    first, _ = field.sampled(turbulence, 400, here)
    along, across = [], []
    for r in SEPARATIONS:
        north, _ = field.sampled(turbulence, 400, here + np.array([r, 0.0, 0.0]))
        east, _ = field.sampled(turbulence, 400, here + np.array([0.0, r, 0.0]))
        along.append(0.5 * np.mean(first[..., 0] * north[..., 0] + first[..., 1] * east[..., 1]))
        across.append(0.5 * np.mean(first[..., 1] * north[..., 1] + first[..., 0] * east[..., 0]))
    return np.array(along), np.array(across)


@pytest.mark.nightly
@pytest.mark.skipif(importlib.util.find_spec("hipersim") is None, reason=f"no hipersim to compare with; {INSTALL}")
def test_boxes_have_the_products_that_are_written_down() -> None:
    found = np.mean([of_a_box(seed) for seed in (1, 2)], axis=0)
    np.testing.assert_allclose(found, OF_BOXES, rtol=1e-4, atol=1e-4)


@pytest.mark.nightly
def test_both_have_the_same_shape_along_and_across() -> None:
    """f and g over f(8 m): a box without what is smaller than its step, and the set of waves, have other variances.

    The boxes have some thousands of pieces of air of the size of L^3, the field 24 000 pairs: standard errors of about
    0.01.
    """
    ours = of_the_field()
    for mine, other, form in zip(ours, OF_BOXES, (field.along, field.across), strict=True):
        closed, dryden = (
            form(SEPARATIONS, LENGTH, name) / field.along(8.0, LENGTH, name) for name in ("von_karman", "dryden")
        )
        shapes = mine / ours[0][0], other / OF_BOXES[0, 0]
        assert np.abs(shapes[0] - shapes[1]).max() < 0.03
        for shape in shapes:
            assert np.abs(shape - closed).max() < 0.02
        # Dryden's form would be seen, and a length that were a fifth off.
        assert np.abs(dryden - closed).max() > 0.04
        longer = form(SEPARATIONS, 1.2 * LENGTH, "von_karman") / field.along(8.0, 1.2 * LENGTH, "von_karman")
        assert np.abs(longer - closed).max() > 0.05
