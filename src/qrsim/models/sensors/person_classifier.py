"""Scores that a classifier gives to windows of a picture (docs/explanation/models/sensors.md)."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import log, sincos
from qrsim.core.tree import parameter, record
from qrsim.models.scene.terrain import CLUTTER, OCCLUSION


class Close(NamedTuple):
    """Parts of the means of the score that change fast at short distances, of any shape."""

    person: Array  # mean with a person
    rise: Array  # without a person: share of the rise, 1 from ``near`` on


@record
class PersonClassifier:
    """Mean and spread of the score of a window, with and without a person, by the distance r to the ground it shows."""

    range_limit: Array = parameter(
        default=50.0, unit="m", doc="range limit: larger ranges r are clipped to it", above=0.0
    )
    near: Array = parameter(default=11.0, unit="m", doc="range r below which the mean changes fast", above=0.0)
    person_mean: Array = parameter(default=0.55, unit="1", doc="with a person: middle of the mean for short r")
    person_swing: Array = parameter(default=0.11, unit="1", doc="with a person: amplitude of the mean for short r")
    person_slope: Array = parameter(default=0.005, unit="1/m", doc="with a person: decrease of the mean beyond")
    occlusion_loss: Array = parameter(default=0.1, unit="1", doc="with a person: decrease of the mean if occluded")
    person_std: Array = parameter(default=0.16, unit="1", doc="with a person: std at r = 0", above=0.0)
    person_std_slope: Array = parameter(default=-0.0061, unit="1/m", doc="with a person: slope of the std")
    person_std_curve: Array = parameter(default=7.4e-5, unit="1/m^2", doc="with a person: curvature of the std")
    none_mean: Array = parameter(default=0.34, unit="1", doc="without a person: mean at r = 0")
    none_rise: Array = parameter(
        default=0.076, unit="1", doc="without a person: rise of the mean for short r, constant beyond"
    )
    none_std: Array = parameter(default=0.09, unit="1", doc="without a person: std at r = 0", above=0.0)
    none_std_slope: Array = parameter(default=-0.0016, unit="1/m", doc="without a person: slope of the std")
    none_std_curve: Array = parameter(default=2.4e-5, unit="1/m^2", doc="without a person: curvature of the std")
    clutter_std: Array = parameter(default=0.04, unit="1", doc="without a person: further std on clutter", minimum=0.0)

    def close(self, distance: Array) -> Close:
        """Return the parts of the mean scores that hold at distances [m] below ``near``, of any shape."""
        part = jnp.minimum(self._clipped(distance) / self.near, 1.0)
        _, cosine = sincos(math.pi * (1.0 + part))
        return Close(self.person_mean + self.person_swing * cosine, part)

    def _clipped(self, distance: Array) -> Array:
        """Return distances clipped to the range limit [m]."""
        return jnp.clip(distance, 0.0, self.range_limit)

    def person(self, distance: Array, ground: Array, close: Close | None = None) -> tuple[Array, Array]:
        """Return mean and std of the score of windows with a person, of any shape.

        Args:
            distance: r [m].
            ground: class of the ground.
            close: ``close(distance)``, where it is known.
        """
        r, (near, _) = self._clipped(distance), self.close(distance) if close is None else close
        beyond = self.person_mean + self.person_swing - self.person_slope * (r - self.near)
        mean = jnp.where(r <= self.near, near, beyond) - jnp.where(ground == OCCLUSION, self.occlusion_loss, 0.0)
        return mean, self.person_std + r * (self.person_std_slope + r * self.person_std_curve)

    def none(self, distance: Array, ground: Array, close: Close | None = None) -> tuple[Array, Array]:
        """Return mean and std of the score of windows without a person, of any shape; see ``person``."""
        r, (_, part) = self._clipped(distance), self.close(distance) if close is None else close
        std = self.none_std + r * (self.none_std_slope + r * self.none_std_curve)
        return self.none_mean + self.none_rise * part, std + jnp.where(ground == CLUTTER, self.clutter_std, 0.0)

    def ratio(self, score: Array, distance: Array, ground: Array, close: Close | None = None) -> Array:
        """Return the log-likelihood ratio of a score: ln N(score; person) - ln N(score; none)."""

        def log_density(mean: Array, std: Array) -> Array:
            """Return the logarithm of a normal density at the score, without its constant."""
            offset = (score - mean) / std
            return -0.5 * offset * offset - log(std)

        return log_density(*self.person(distance, ground, close)) - log_density(*self.none(distance, ground, close))
