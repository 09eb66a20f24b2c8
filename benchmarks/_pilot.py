"""One controller of a shared world, in a process of its own: ``_pilot.py PORT VEHICLE SECONDS``; prints what it saw.

It needs NumPy and protobuf only. Each tick it waits for what its vehicle senses, and sends an order at once.
"""

from __future__ import annotations

import json
import sys
import time


def main() -> None:
    """Fly, and print JSON: latency of each order [ms], readings, and those that were missed."""
    from qrsim.links.reference.client import Client

    port, name, seconds = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    sent: dict[int, float] = {}
    out: dict[int, float] = {}
    ticks, missed = [], 0
    with Client(port=port, timeout=120.0) as client:
        # All wait for the last of them, who claims what is left.
        print("ready", flush=True)
        sys.stdin.readline()
        client.claim(name)
        client.subscribe()
        end = None
        while end is None or time.monotonic() < end:
            seen = client.sensed(60.0)
            end = time.monotonic() + seconds if end is None else end
            ticks.append(seen.tick)
            out[seen.tick], missed = seen.sent, seen.missed
            now = time.monotonic()
            gnss = seen.vehicles[name].sensors["gnss"]["position_ned"]
            order = ("velocity_height", [0.2 * (gnss[0] < 0.0), 0.0, -30.0, 0.0])
            sent[client.command({name: order}, computed_from=seen.tick)] = now
        pacing = client.status().pacing
    # An order is flown from a tick on whose state is sent when it is over for those who read.
    latency = [1e3 * (out[tick] - when) for tick, when in sent.items() if tick in out]
    print(json.dumps({"latency_ms": latency, "ticks": len(ticks), "missed": missed, "pacing": pacing}))


if __name__ == "__main__":
    main()
