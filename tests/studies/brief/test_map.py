"""The map of a brief."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import to_hex

from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.brief.figures import map_figure


def test_zones_and_buildings_are_drawn() -> None:
    barn = {"type": "prism", "corners_ned": [[20, 20], [20, 30], [30, 30], [30, 20]], "z_min": -9}
    area = {
        "type": "zones",
        "stay_in": [{"polygon_ned": [[-50, -50], [-50, 50], [50, 50], [50, -50]]}],
        "stay_out": [{"circle_ned": [20, -20], "radius": 5, "name": "Chapel"}],
    }
    vehicle = {"position_ned": [0, 0, -10], "legs": [{"to_ned": [40, 0, -10]}]}
    scenario = load_scenario(
        {
            "name": "map",
            "world": {"area": area, "obstacles": [barn]},
            "fleets": {"a": {"controller": {"type": "cascade", "feed": "truth"}, "vehicles": [vehicle]}},
        }
    )
    tracks = np.zeros((1, 2, 1, 4))
    tracks[0, 1, 0, 0] = 40.0
    axes = map_figure(scenario, tracks, [0], np.array([[30.0, 1.0]])).axes[0]
    # East is x; the picture ends 5 m outside the area.
    assert axes.get_xlim()[0] == -55.0
    assert {text.get_text() for text in axes.get_legend().get_texts()} == {
        "planned route",
        "stay in",
        "stay out",
        "start",
        "worst runs (1)",
        "last record of a lost run",
    }
    assert len(axes.patches) == 3
    assert "#bfbfbf" in {to_hex(each.get_facecolor()) for each in axes.patches}
