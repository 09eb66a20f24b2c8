"""What a prompt and a notebook show of objects: the names that they have, numbers and units."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np

import qrsim
from qrsim.core.tables import MOST_ROWS, Table, number_text
from qrsim.interface.readings import Reading
from qrsim.simulation.rollout import Rollout
from qrsim.simulation.simulation import Simulation
from small_worlds import noisy, noisy_pair, simulate


def rows(text: str) -> dict[str, list[str]]:
    """Return the cells of each row of a table by the first one."""
    cells = [[cell for cell in line.split("  ") if cell] for line in text.splitlines()[1:]]
    return {row[0].strip(): [cell.strip() for cell in row[1:]] for row in cells}


def test_a_table_is_shown_in_columns_and_escaped_for_notebooks() -> None:
    table = Table("two", ("name", "unit"), [("a<b", "m"), ("longer", "m/s")])
    assert table.text() == "two\n  name    unit\n  a<b     m\n  longer  m/s"
    assert "<td>a&lt;b</td><td>m</td>" in table.html()
    assert Table("many", ("name",), [("x",)] * (MOST_ROWS + 3)).text().endswith("\n  and 3 more")
    assert number_text(np.arange(6)) == "0, 1, 2, 3, ... (6)"
    assert number_text(np.float32(1.0 / 3.0)) == "0.3333"


def test_readings_complete_and_show_numbers_with_units() -> None:
    simulation = simulate(noisy(), seed=3)
    reading = simulation.step(ticks=10)
    assert {"gnss", "barometer", "attitude", "estimate", "time"} <= set(dir(reading))
    assert {"gnss", "estimate"} <= set(dir(reading["pelicans"]))
    assert {"position_ned", "latitude_deg", "reasons", "time_of_reading"} <= set(dir(reading.gnss))
    assert repr(reading).startswith("reading at 0.2 s\n")
    shown = rows(repr(reading))
    first = reading.gnss.position_ned[0]
    assert shown["gnss.position_ned"][:2] == ["m", ", ".join(f"{value:.4g}" for value in first)]
    assert shown["barometer.height"][0] == "m"
    assert shown["field"] == ["unit", "pelicans_0", "pelicans_1", "pelicans_2", "pelicans_3", "(5 in all)"]
    assert rows(repr(reading.gnss))["latitude_deg"][:2] == ["deg", f"{reading.gnss.latitude_deg[0]:.9g}"]
    assert rows(repr(reading.estimate))["attitude"][0] == "rad"
    assert "<td>gnss.position_ned</td><td>m</td>" in reading._repr_html_()
    truth = rows(repr(simulation.truth))
    assert truth["velocity_ned"][:2] == ["m/s", ", ".join(f"{v:.4g}" for v in simulation.truth.velocity_ned[0])]


def test_several_fleets_are_shown_one_after_the_other() -> None:
    reading = simulate(noisy(fleet_more=True)).reading
    assert reading.fleets == ("others", "pelicans")
    assert reading._ipython_key_completions_() == list(reading.fleets)
    for fleet in reading.fleets:
        assert f"fleet '{fleet}'" in repr(reading)


def test_a_reading_that_is_traced_can_be_printed() -> None:
    """Of numbers that are not there yet it shows type and shape."""
    shown: list[str] = []

    @jax.jit
    def policy(reading: Reading) -> None:
        shown.append(repr(reading))

    qrsim.rollout(noisy(), policy, ticks=2)
    assert rows(shown[0])["gnss.position_ned"][1] == "float32[5, 3]"
    assert "latitude_deg" not in shown[0]


def test_a_simulation_shows_its_vehicles() -> None:
    simulation = Simulation(noisy_pair().world(), seed=4, name="pair")
    assert repr(simulation) == "simulation 'pair' not started, seed 4, float32: reset() starts it"
    simulation.reset()
    assert repr(simulation).startswith("simulation 'pair' at 0 s, tick 0, seed 4, float32\n")
    assert rows(repr(simulation))["vehicles_1"][-1] == "flies"


def test_scenario_and_world_show_their_parts() -> None:
    scenario = qrsim.load_scenario("hover")
    assert repr(scenario).startswith("scenario 'hover' of ")
    assert rows(repr(scenario))["world.wind"][0] == "log_shear"
    shown = rows(repr(scenario.world()))
    assert shown["world.wind"][0] == "LogShear"
    assert shown["world.wind"][1].startswith("speed_20ft 5 m/s, ")
    assert shown["fleets.pelicans.vehicle"][1].startswith("mass 1.68 kg, gravity 9.81 m/s^2")


def test_a_rollout_shows_its_metrics() -> None:
    metrics = {"flown_s": np.array([[0.06], [0.02]]), "wind_max_m_s": np.full((2, 1), np.nan)}
    flown = Rollout(metrics, None, np.zeros(0), np.arange(2), np.zeros(2), ("pelicans_0",))
    assert repr(flown).startswith("rollout of 2 worlds of 1: pelicans_0\n")
    assert rows(repr(flown))["flown_s"] == ["s", "(2, 1)", "0.02", "0.04", "0.06"]
    assert rows(repr(flown))["wind_max_m_s"] == ["m/s", "(2, 1)"]
    assert flown._ipython_key_completions_() == ["flown_s", "wind_max_m_s"]
    flown.record_ticks = np.arange(4)
    assert repr(flown).startswith("rollout of 2 worlds of 1: pelicans_0; recorded at 4 ticks\n")


def recorded(folder: Path) -> Path:
    qrsim.fly(noisy_pair(duration=0.2), folder, seed=1, precision="float32")
    return folder


def test_a_run_shows_its_streams(tmp_path: Path) -> None:
    run = qrsim.open_run(recorded(tmp_path / "run"))
    assert "position_ned.x" in rows(repr(run))["truth"][1]
    assert rows(repr(run["truth"]))["position_ned.x"][:2] == ["m", "float64"]
    assert "truth" in run._ipython_key_completions_()
    assert "position_ned.x" in run["truth"]._ipython_key_completions_()


def test_a_damaged_run_can_be_printed(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "run")
    for part in (folder / "truth").iterdir():
        part.write_bytes(b"damaged")
    assert "cannot be shown" in repr(qrsim.open_run(folder)["truth"])
