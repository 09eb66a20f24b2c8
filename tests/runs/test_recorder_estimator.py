"""What a run says of an estimator of the user's."""

from __future__ import annotations

import warnings

import pytest

import qrsim
from qrsim.runs.recorder import _new_pilot


def estimate(reading):
    return None


def test_a_scenario_with_an_estimator_logs_that_one_and_says_so():
    simulation = qrsim.load("hover")
    simulation.reset()
    with pytest.warns(UserWarning, match="the log's estimate is that of fleets.pelicans.estimator"):
        _new_pilot(simulation, None, estimate, 1)
    plain = qrsim.load("hover_ideal")
    plain.reset()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _new_pilot(plain, None, estimate, 1)
