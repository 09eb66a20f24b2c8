"""One core, and more threads than cores: the bits of all cores."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import hashlib, os, sys
if sys.argv[1] == "one core":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import numpy as np, qrsim
from qrsim.scenarios.reading import read_scenario
if sys.argv[1] == "one core":
    qrsim.configure(cpu_devices=5)
for name in ("outdoor_patrol", "mixed_team"):
    content = read_scenario(name)[1]
    if name == "outdoor_patrol":
        # A world of one vehicle.
        del content["fleets"]["pelicans"]["vehicles"][1:]
    scenario = qrsim.load_scenario(content, quiet=True)
    simulation = qrsim.Simulation(scenario.world("float32"), seed=3, name=name, site=scenario.site)
    simulation.reset()
    simulation.advance(ticks=100)
    state = b"".join(np.asarray(part).tobytes() for part in simulation.packed[1])
    print(simulation.size, hashlib.sha256(state).hexdigest())
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs the affinity of a process")
@pytest.mark.long
def test_one_core_with_five_threads_changes_no_bit_of_one_vehicle_or_of_several_kinds() -> None:
    found = [
        subprocess.run([sys.executable, "-c", PROGRAM, cores], capture_output=True, text=True, check=True, timeout=300)
        for cores in ("all cores", "one core")
    ]
    assert found[0].stdout == found[1].stdout
    # A quadrotor alone; and multirotors of two models, fixed wings and rovers.
    assert [line.split()[0] for line in found[0].stdout.splitlines()] == ["1", "9"]
