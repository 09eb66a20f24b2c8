"""Environment steps a second through Gymnasium: keep_spot beside those of crazyflow and PyFlyt, in the same run.

keep_spot has gusts and five noisy sensors, which the others lack; a step is 0.02 s, PyFlyt's 0.025 s. Each peer lives
in an environment of its own, as for peers.py; ``--install`` makes those that are missing. PyFlyt steps its
environments one after the other, so that more of them take longer and not less: it is measured up to ``MOST`` of them.
"""

from __future__ import annotations

import argparse
import subprocess
from collections.abc import Sequence
from typing import Any

import _common
import envs
import peers

PEERS = {"crazyflow": "DroneReachPos-v0", "pyflyt": "PyFlyt/QuadX-Hover-v4"}
MODULES = {"crazyflow": "crazyflow", "pyflyt": "PyFlyt"}
MOST = {"pyflyt": 64}
HEADINGS = {
    "simulator": "simulator",
    "environment": "environment",
    "num_envs": "num_envs",
    "per_wall_second": "steps/s (wall)",
    "per_cpu_second": "steps/s (CPU)",
    "ours_to_theirs": "steps: ours/theirs",
    "note": "note",
}


def ours(size: int, seconds: float, repeats: int) -> dict[str, Any]:
    """Return the row of keep_spot."""
    found = envs.measure("keep_spot", size, seconds, repeats)
    return row("qrsim", envs.ENVIRONMENTS["keep_spot"], size) | {
        key: found[key] for key in ("per_wall_second", "per_cpu_second")
    }


def row(simulator: str, environment: str, size: int) -> dict[str, Any]:
    """Return a row without numbers."""
    known = {"simulator": simulator, "environment": environment, "num_envs": size, "note": ""}
    return dict.fromkeys(HEADINGS) | known


def theirs(name: str, size: int, seconds: float, own: dict[str, Any]) -> dict[str, Any]:
    """Return the row of a peer, with a note in place of numbers where there are none."""
    blank = row(peers.REQUIREMENTS[name], PEERS[name], size)
    peer = peers.Peer(name, "", "", size, 1, module=MODULES[name])
    if not peers.installed(peer):
        return blank | {"note": "not installed: python benchmarks/env_peers.py --install"}
    try:
        (found,) = peers.run_together(name, [f"_peer_{name}_env.py", str(size)], 1, seconds)
    except (subprocess.TimeoutExpired, RuntimeError) as error:
        return blank | {"note": f"did not run: {error}"}
    if not found["finite"]:
        return blank | {"note": "did not run: what it saw became infinite"}
    rate = found["steps"] / found["wall"]
    return blank | {
        "per_wall_second": round(rate),
        "per_cpu_second": round(found["steps"] / found["cpu"]),
        "ours_to_theirs": own["per_wall_second"] / rate,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="*", metavar="N", help="num_envs (default: 1 64 1024 16384)")
    parser.add_argument("--install", action="store_true", help="make the environments that are missing, then measure")
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    parser.add_argument("--quick", action="store_true", help="the smallest form; its numbers mean nothing")
    chosen = parser.parse_args(arguments)
    for name in PEERS if chosen.install else ():
        if not peers.installed(peers.Peer(name, "", "", 1, 1, module=MODULES[name])):
            peers.install(name)
    _common.without_cache()
    on = _common.machine()
    from qrsim import envs as registered

    registered.register()
    sizes = chosen.sizes or ((2,) if chosen.quick else envs.SIZES)
    seconds, repeats = (0.01, 1) if chosen.quick else (3.0, 3)
    rows = []
    for size in sizes:
        own = ours(size, seconds / repeats, repeats)
        rows.append(own)
        rows += [theirs(name, size, seconds, own) for name in PEERS if size <= MOST.get(name, size)]
    _common.publish(
        "env_peers", "Environments of others: ours over theirs, as many in each", on, rows, HEADINGS, chosen.json
    )


if __name__ == "__main__":
    main()
