"""``qrsim ros2 --api px4|mavros`` and an offboard node in another process, which has the DDS library alone."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

pytestmark = pytest.mark.long
NODES = Path(__file__).with_name("offboard_nodes.py")
DOMAIN = 100 + (os.getpid() + 75) % 100
ALONE = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>'
    "</Domain></CycloneDDS>"
)
SCENARIO = """
extends: mavlink_field
fleets:
  field: {vehicles: {count: 2, spacing: 8.0, position_ned: [20, 10, 0], on_ground: true, legs: [{type: land}]}}
"""


@pytest.mark.parametrize(
    ("api", "space"), [("px4", "/px4_1"), pytest.param("mavros", "/uav1", marks=pytest.mark.nightly)]
)
def test_an_offboard_node_flies_one_of_two_vehicles(api, space, tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", ALONE)
    (tmp_path / "pair.yaml").write_text(SCENARIO)
    code = "import sys; from qrsim.cli import main; sys.exit(main())"
    words = ["ros2", str(tmp_path / "pair.yaml"), "--api", api, "--domain", str(DOMAIN), "--realtime", "3"]
    words += ["--namespaces", "uav{n}"] if api == "mavros" else []
    lines = tmp_path / "lines"
    with lines.open("w") as out:
        server = subprocess.Popen([sys.executable, "-c", code, *words], stdout=out, stderr=out)
    try:
        end = time.monotonic() + 90.0
        while "topics" not in lines.read_text() and server.poll() is None and time.monotonic() < end:
            time.sleep(0.1)
        done = subprocess.run(
            [sys.executable, str(NODES), api, str(DOMAIN), space],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr + lines.read_text()
        heights = ["3.0", "-3.0"]
        assert done.stdout.splitlines()[-4:] == [
            "offboard, armed",
            f"at 0.0 0.0 {heights[api == 'px4']}",
            "at 0.0 5.0 -3.0" if api == "px4" else "at 5.0 0.0 3.0",
            "landed",
        ]
    finally:
        server.terminate()
        server.wait(20.0)
