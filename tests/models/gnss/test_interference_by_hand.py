"""What jammers, discs and spoofers add, by hand from (G25) and (G26) of docs/explanation/models/gnss.md."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.core.vectors import Vec3
from qrsim.models.gnss.interference import (
    Circle,
    Disc,
    Emitter,
    Interference,
    Interfering,
    Lie,
    Spoofer,
    jammed,
    lied_to,
    strength,
)

# What compiles these programs in the least time.
QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
HERE = np.zeros(3)
NOBODY, EVERYBODY = np.zeros(3, bool), np.ones(3, bool)


def vec(north: Any, down: Any = 0.0) -> Vec3:
    """Return places (n,) in the plane of the meridian."""
    north = np.atleast_1d(np.asarray(north, np.float32))
    return Vec3(north, 0.0 * north, 0.0 * north + np.float32(down))


def emitter() -> Interfering:
    """Return a jammer at the origin, 1 m^2 strong."""
    point: Any = (np.float32(0.0),) * 3
    one: Any = np.float32(1.0)
    return Interfering((Emitter(Vec3(*point), one),), (), (), NOBODY)  # type: ignore[arg-type]


def at(item: Interference, seconds: int, fraction: float = 0.0) -> Any:
    """Return what interferes at a time."""

    def program(seconds: Any, fraction: Any) -> Any:
        return item.at(np.zeros(1, np.int32), seconds, fraction)  # type: ignore[arg-type]

    return jax.jit(program, compiler_options=QUICK)(np.int32(seconds), np.float32(fraction))


def added(now: Any, place: Vec3, affected: Any = (), ground: Any = None, skyline: Any = None) -> Any:
    """Return what is added to 1/(c/n0) at places (n,)."""

    def program(now: Any, place: Vec3, affected: Any) -> Any:
        return jammed(now, affected, place, ground, skyline)

    return jax.jit(program, compiler_options=QUICK)(now, place, affected)


@pytest.mark.parametrize(("band", "quality"), [("wide", 2.0 / 0.903), ("narrow", 1.0)])
def test_strength_of_a_jammer_of_1_w(band: str, quality: float) -> None:
    """(lambda/(4 pi))^2 over -157 dBW is j/s at 1 m; over Q and 1.023 MHz it adds to 1/(c/n0), counted from 45 dB-Hz.

    The wavelength of L1, 154 times 10.23 MHz, is 0.1902936728 m; 0.903 of the code's power is in its main lobe.
    """
    to_noise = (0.1902936728 / (4.0 * math.pi)) ** 2 / 1.9952623149689e-16
    expected = to_noise / (quality * 1.023e6) * 31622.776601684
    assert float(strength(1.0, band)) == pytest.approx(expected, rel=1e-5)


def test_power_grows_up_to_1_m() -> None:
    """As the square of the distance; the jammer is above."""
    found = added(emitter(), vec([2.0, 1.1, 0.5], 1e-3))
    np.testing.assert_allclose(found, [0.25, 1.0 / 1.21, 1.0], rtol=1e-5)


def test_gain_towards_what_is_below_or_hidden() -> None:
    """-5 dB from below, -20 dB behind a hill, as much behind a wall."""
    hidden = SimpleNamespace(line_of_sight=lambda at, point: NOBODY[:1], sees=lambda at, point: NOBODY[:1])
    above, below = vec(10.0, 1e-3), vec(10.0, -1e-3)
    found = [
        float(added(emitter(), place, (), ground, skyline)[0])
        for place, ground, skyline in (
            (above, None, None),
            (below, None, None),
            (above, hidden, None),
            (above, None, hidden),
            (below, hidden, hidden),
        )
    ]
    np.testing.assert_allclose(found, [0.01, 0.00316227766, 1e-4, 1e-4, 3.16227766e-7], rtol=1e-5)


def test_a_disc_takes_90_db() -> None:
    """Ours: from 45 dB-Hz to -45 dB-Hz, where nothing is tracked."""
    point: Any = (np.float32(0.0),) * 3
    radius: Any = np.float32(100.0)
    disc = Interfering((), (Circle(Vec3(*point), radius),), (), NOBODY)  # type: ignore[arg-type]
    found = added(disc, vec([0.0, 99.0, 101.0]))
    np.testing.assert_allclose(found, [1e9, 1e9, 0.0], rtol=1e-6)


def test_what_is_off_reaches_nobody_not_even_in_its_middle() -> None:
    middle = vec([0.0, 0.5, 0.9])
    disc = Interference(discs=(Disc(HERE, 100.0, 1.0, 2.0),))  # type: ignore[arg-type]
    np.testing.assert_array_equal(added(at(disc, 3), middle), np.zeros(3))
    liar: Any = (HERE, np.ones(3), HERE, 100.0, 5.0, 10.0, 40.0)
    spoofer = Interference(spoofers=(Spoofer(*liar),))
    for second in (9, 41):
        now = at(spoofer, second)
        np.testing.assert_array_equal(added(now, middle, (EVERYBODY,)), np.zeros(3))
        assert not np.any(jax.jit(lied_to, compiler_options=QUICK)(now, (EVERYBODY,), middle)[0])


@pytest.mark.parametrize(("fraction", "jams"), [(0.99989, True), (0.99991, False), (0.99995, False), (0.0, True)])
def test_a_spoofer_stops_jamming_a_shortest_step_early(fraction: float, jams: bool) -> None:
    """The shortest step is 0.1 ms, and a tick of less before the end of a second has the end in it."""
    liar: Any = (HERE, np.ones(3), HERE, 100.0, 1.0, 0.0, 40.0)
    (lie,) = at(Interference(spoofers=(Spoofer(*liar),)), 0, fraction).lies
    assert isinstance(lie, Lie)
    assert bool(lie.jams) == jams
