"""``qrsim brief``: wrong inputs, each with a message that names the place and what was allowed; nothing is compiled."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from tests.studies.brief.plans import HOME, TAKE_OFF, WAYPOINT, item, write_plan

from qrsim import cli
from qrsim.studies.brief.operation import read_operation

WIND, X500, AT = ("--wind", "7@250"), ("--vehicle", "x500"), ("--at", "2026-05-01T10:00Z")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    def fly(*_: object) -> None:
        raise AssertionError("it flies")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("qrsim.studies.brief.briefing.fly", fly)
    write_plan(tmp_path / "a.plan")
    (tmp_path / "list.yaml").write_text("[1, 2]")
    return tmp_path


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert cli.main(["brief", *words]) == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (X500, "a: needs the wind: --wind SPEED@FROM"),
        ((*X500, "--wind", "250@7"), "--wind 250@7: 250 m/s is out of range; is it 7@250?"),
        ((*X500, "--wind", "7@400"), "--wind 7@400: bearing 400; allowed: 0 to 360"),
        ((*X500, "--wind", "7"), "--wind 7: expected SPEED@FROM, for example 7@250"),
        ((*X500, "--wind", "14mph@250"), "the unit 'mph' is unknown"),
        ((*X500, "--wind", "60@250"), "60 m/s is out of range; allowed: 0 to 50"),
        ((*X500, *WIND, "--at", "2026-05-01T10:00"), "needs Z (UTC) or an offset"),
        ((*X500, *WIND, "--at", "tomorrow"), "is no time; expected for example 2026-05-01T10:00Z"),
        ((*WIND, *AT), "needs the vehicle: --vehicle NAME or FILE.yaml; names: x500"),
        ((*WIND, *AT, "--vehicle", "x5000"), "no model is called 'x5000'; did you mean 'x500'?"),
        ((*WIND, *AT, "--vehicle", "b=x500"), "no plan is called 'b'"),
        ((*WIND, *AT, *X500, "--vehicle", "pelican"), "--vehicle pelican: is a second one for all plans"),
        ((*WIND, *AT, "--vehicle", "mine.yaml"), "vehicle file mine.yaml: no such file"),
        ((*WIND, *AT, *X500, "--minutes", "0"), "--minutes 0: allowed: above 0"),
        ((*WIND, *AT, *X500, "--longest", "0.005"), "allowed: 18 s; see --longest"),
        ((*WIND, *AT, *X500, "--workers", "0"), "--workers 0: expected a positive number"),
        ((*WIND, *AT, *X500, "--seed", "-1"), "--seed -1: expected an integer"),
        ((*WIND, *AT, *X500, "--precision", "2"), "--precision 2: allowed: above 0, below 1 (2 % is 0.02)"),
        ((*WIND, *AT, *X500, "--battery", "no.yaml"), "--battery no.yaml: cannot be read: No such file or directory"),
        ((*WIND, *AT, *X500, "--battery", "list.yaml"), "--battery list.yaml: expected numbers of a pack"),
        ((*AT, *X500, "--wind", "gfs.grib2"), "gfs.grib2"),
        ((*WIND, *AT, *X500, "--write", "o.txt"), "--write o.txt: expected the name of a .yaml file"),
    ],
)
def test_wrong_words(folder: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str) -> None:
    assert message in refused(capsys, "a.plan", *words)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"criteria": {"reserve": 20}}, "criteria.reserve: 20 is out of range; allowed: 0 to 0.9 (20 % is 0.2)"),
        ({"criteria": {"resreve": 0.2}}, "criteria.resreve: no such parameter of 'criteria'; did you mean 'reserve'?"),
        ({"faults": ["moter"]}, "faults.0: 'moter' is not allowed; allowed: motor, gnss, link, low_battery"),
        ({"wind": {"speed": 7, "from": 250, "std": -1}}, "wind.std: -1 is out of range"),
        ({"wind": {"speed": 7, "from": 400}}, "400 is out of range; allowed: 0 to 360"),
        ({"wind": None}, "wind: "),
        ({"uncertain": {"mass": "90 %"}}, "uncertain.mass: 0.9 is out of range; allowed: 0 to 0.5"),
        # An X500 has a thrust to weight of 1.67: above 39.5 % more mass it is below 1.2.
        (
            {"uncertain": {"mass": "50 %"}},
            "10 % of the draws of a have a thrust to weight below 1.2; allowed: up to 39.5 %",
        ),
        ({"window": "half an hour"}, "window: 'half an hour' is not a number"),
        ({"missions": [{"plan": "a.plan", "vehicle": "x500"}] * 61}, "missions: expected at most 60 entries, found 61"),
        ({"uncertain": {"initial_charge": [1.0, 0.9]}}, "allowed: ascending, above 0, at most 1"),
        ({"missions": []}, "missions: "),
        (
            {"wind": {"speed": 7, "from": 250, "file": "w.csv"}},
            "wind: gives 'speed' and 'file'; give speed and from, or file",
        ),
        ({"wind": {"speed": 7}}, "wind: gives neither 'from_deg' nor 'file'"),
        ({"site": {"latitude_deg": 51.0}}, "gives one of latitude_deg and longitude_deg; give both, or neither"),
        ({"site": {"keepout": ["a.kml"]}}, "did you mean 'keep_out'?"),
        ({"site": {"terrain": ["no.hgt"]}}, "no.hgt"),
        ({"site": {"keep_out": ["no.kml"]}}, "no.kml"),
        ({"missions": [{"plan": "a.plan", "vehicle": "x500"}] * 2}, "missions: two are called 'a'"),
        ({"site": {"ceiling": "high"}}, "site.ceiling: 'high' is not a number (height above home [m])"),
        # The route is up to 12 m high.
        ({"site": {"ceiling": 10}}, "a.plan: item 3: z = -12 m is outside world.area; allowed: -10 to 0"),
        ({"world": {"wind": {"type": "calm"}}}, "world: the wind of an operation is its own key"),
        ({"extends": "no_such_scenario"}, "no scenario is called 'no_such_scenario'"),
        ({"contingency": {"low_battery": {"do": "retrun"}}}, "'retrun' is not allowed; allowed: warn, land, return"),
        ({"at": "10 o'clock"}, "is no time"),
    ],
)
def test_wrong_operations(
    folder: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, object], message: str
) -> None:
    good = {
        "operation": "field",
        "at": "2026-05-01T10:00Z",
        "missions": [{"plan": "a.plan", "vehicle": "x500"}],
        "wind": {"speed": 7, "from": 250},
    }
    Path("field.yaml").write_text(yaml.safe_dump({**good, **changes}))
    assert message in refused(capsys, "field.yaml")


def test_files_of_an_operation_are_in_its_folder(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And the area of the scenario below holds, not the fence of the plan; the route crosses 'Barn' for 10 m."""
    zone = {"name": "Barn", "polygon_ned": [[5, -5], [5, 5], [15, 5], [15, -5]]}
    area = {"type": "zones", "z_min": -60, "stay_in": [{"file": "a.plan"}], "stay_out": [zone]}
    there = folder / "there"
    there.mkdir()
    write_plan(there / "a.plan", fence=[(-50, -50), (-50, 50), (50, 50), (50, -50)])
    site = {"latitude_deg": HOME[0], "longitude_deg": HOME[1], "height_amsl": HOME[2]}
    operation = {
        "at": "2026-05-01T10:00Z",
        "missions": [{"plan": "a.plan", "vehicle": "x500"}],
        "wind": {"speed": 7, "from": 250},
    }
    crossed = "item 2: 10 m of it are inside 'Barn'"
    (there / "site.yaml").write_text(yaml.safe_dump({"site": site, "world": {"area": area}}))
    (there / "field.yaml").write_text(yaml.safe_dump({**operation, "extends": "site.yaml"}))
    found = refused(capsys, "there/field.yaml")
    assert crossed in found
    assert found.startswith("error: operation field: ")
    (there / "field.yaml").write_text(yaml.safe_dump({**operation, "world": {"area": area}}))
    assert crossed in refused(capsys, "there/field.yaml")


def test_wrong_plans(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_plan(Path("empty.plan"), [])
    assert "empty.plan: mission.items: is empty" in refused(capsys, "empty.plan", *X500, *WIND, *AT)
    jump = {"type": "SimpleItem", "command": 177, "frame": 2, "params": [1, -1, 0, 0, 0, 0, 0], "doJumpId": 3}
    items = [item(TAKE_OFF, 0, 0, 12) | {"doJumpId": 1}, item(WAYPOINT, 20, 0, 12) | {"doJumpId": 2}, jump]
    write_plan(Path("round.plan"), items)
    assert "round.plan: repeats for ever" in refused(capsys, "round.plan", *X500, *WIND, *AT)
    away = [(12.0, -60.0), (12.0, 60.0), (80.0, 60.0), (80.0, -60.0)]
    write_plan(Path("out.plan"), fence=away)
    assert "home of out.plan is 12 m outside the fence of out.plan; move" in refused(
        capsys, "out.plan", *X500, *WIND, *AT
    )
    write_plan(Path("far.plan"), home=(HOME[0] + 0.72, *HOME[1:]))
    assert "far.plan: its home is 80 km from that of a.plan; allowed: 50" in refused(
        capsys, "a.plan", "far.plan", *X500, *WIND, *AT
    )
    write_plan(Path("near.plan"), home=(HOME[0] + 1.0 / 111_250.0, *HOME[1:]))
    assert "starts 1 m from missions.a; allowed: at least 2 m (world.collision_distance)" in refused(
        capsys, "a.plan", "near.plan", *X500, *WIND, *AT
    )
    assert "o.yaml: no such file" in refused(capsys, "o.yaml")
    assert "b.csv: expected a plan (.plan, .waypoints" in refused(capsys, "b.csv", *X500, *WIND)


def test_an_operation_is_written_and_read(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("there").mkdir()
    assert cli.main(["brief", "a.plan", *X500, "--wind", "14kn@250", *AT, "--write", "there/field.yaml"]) == 0
    assert "wind: 14kn@250 is 7.2 m/s" in capsys.readouterr().err
    found = yaml.safe_load(Path("there/field.yaml").read_text())
    assert found["missions"][0]["plan"] == "../a.plan"
    assert found["wind"] == {"speed": 7.202, "from_deg": 250.0, "height": 10.0, "std": 1.5, "from_std": 15.0}
    assert found["criteria"]["p_loss"] == 0.01
    # It is read again, with what the command line says in its place.
    assert cli.main(["brief", "there/field.yaml", "--at", "2026-05-01T12:00+02:00", "--write", "again.yaml"]) == 0
    again = yaml.safe_load(Path("again.yaml").read_text())
    assert again["missions"][0]["plan"] == "a.plan"
    assert (again["at"], again["contingency"]) == ("2026-05-01T10:00:00Z", found["contingency"])


def test_a_folder_of_something_else(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine").mkdir()
    Path("mine/notes.txt").write_text("mine")
    words = ("a.plan", *X500, *WIND, *AT)
    assert "mine: it exists and is no folder of a brief" in refused(capsys, *words, "--out", "mine")
    Path("other").mkdir()
    assert cli.main(["brief", "a.plan", *X500, "--wind", "8@250", *AT, "--write", "other/operation.yaml"]) == 0
    printed = refused(capsys, *words, "--out", "other")
    assert "other: was made of another operation; --out another folder, or --again" in printed
    assert "wind.speed: 7.0 here, 8.0 there" in printed


def test_a_store_of_another_version(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is refused before anything is flown, and --again is named."""
    words = ("a.plan", *X500, *WIND, *AT)
    store = Path("briefs/a/nominal_0.zarr")
    store.mkdir(parents=True)
    assert cli.main(["brief", *words, "--write", "briefs/a/operation.yaml"]) == 0
    operation = read_operation(Path("briefs/a/operation.yaml"), {})
    Path("briefs/a/operation.yaml").write_text(
        operation.model_copy(
            update={"missions": [operation.missions[0].model_copy(update={"plan": "a.plan"})]}
        ).to_yaml()
    )
    (store / "zarr.json").write_text(json.dumps({"attributes": {"versions": {"qrsim": "0.1"}}}))
    printed = refused(capsys, *words)
    assert "briefs/a: was flown with other versions; --again begins it again, or --out another folder" in printed
    assert ", 0.1 there" in printed


def test_a_forecast_is_of_the_time_of_the_flights(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = ["time,height,speed,direction", *(f"2026-05-01T{hour:02}:00Z,10,7,250" for hour in (9, 11))]
    Path("wind.csv").write_text("\n".join(rows) + "\n")
    printed = refused(capsys, "a.plan", *X500, "--wind", "wind.csv", "--at", "2026-05-01T12:00Z")
    assert "wind.csv: " in printed
    assert "2026-05-01 09:00" in printed
    assert cli.main(["brief", "a.plan", *X500, "--wind", "wind.csv", *AT, "--write", "w.yaml"]) == 0
    assert yaml.safe_load(Path("w.yaml").read_text())["wind"]["file"] == "wind.csv"


def test_a_precision_has_to_fit_into_the_time(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = refused(capsys, "a.plan", *X500, *WIND, *AT, "--precision", "0.0001")
    # Wilson's interval of none of n is z^2/(n + z^2) wide, z = 1.96.
    assert "--precision 0.0001: needs about 38411 runs, " in printed
    assert "--minutes " in printed
