"""``qrsim export``, read back with other programs' libraries."""

from __future__ import annotations

import json
import math
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pymap3d
import pytest
import scipy
from mcap.reader import make_reader

from qrsim import cli
from qrsim.runs import Column, RunInfo, RunWriter, open_run
from qrsim.runs.export.mcap_scene import scene
from qrsim.runs.export.place import place_of
from qrsim.runs.surroundings import Surroundings

NAMES = ('a/b <"é">&', "plain")
LATITUDE, LONGITUDE, HEIGHT = 51.5, -0.25, 120.0
UNDULATION = 46.10  # [m] of the geoid EGM96 there
STEP, TICKS, PART, FIX_TICKS = 0.02, 60, 20, 10
# In UTC: 10 o'clock.
START, START_UTC = "2026-06-21T12:00:00.5+02:00", datetime(2026, 6, 21, 10, 0, 0, 500_000, UTC)
LOST = range(20, 40)  # ticks at which "plain" has no fix
GPX = {"": "http://www.topografix.com/GPX/1/1"}
KML = {"": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}
NOTHING = {"ticks": 0, "events": False}


def vector(name: str, unit: str, dtype: str = "float64") -> list[Column]:
    return [Column(f"{name}.{axis}", unit, "", dtype) for axis in "xyz"]


COLUMNS = {
    "truth": [
        *vector("position_ned", "m"),
        *(Column(f"attitude.{angle}", "rad") for angle in ("roll", "pitch", "yaw")),
        Column("valid", "", "", "bool"),
    ],
    "measurements": [*vector("gps.position_ned", "m"), Column("gps.satellites", "1", "", "float32")],
    "wind": [*vector("mean_ned", "m/s", "float32"), *vector("gust_ned", "m/s", "float32")],
}


def true_position(tick: int, vehicle: int) -> np.ndarray:
    return np.array([3.0 * tick, 40.0 * vehicle - tick, -20.0 - 0.1 * tick])


def values_of(ticks: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
    position = np.array([[true_position(tick, vehicle) for vehicle in (0, 1)] for tick in ticks]).reshape(-1, 2, 3)
    fix = np.array([[true_position(t // FIX_TICKS * FIX_TICKS, v) + 1.0 for v in (0, 1)] for t in ticks])
    fix = fix.reshape(-1, 2, 3)
    fix[(ticks >= LOST.start) & (ticks < LOST.stop), 1] = np.nan
    flat = np.ones((len(ticks), 2))
    attitude = {"attitude.roll": 0.1 * flat, "attitude.pitch": 0.2 * flat, "attitude.yaw": 0.3 * flat}
    truth = {f"position_ned.{axis}": position[..., i] for i, axis in enumerate("xyz")}
    measured = {f"gps.position_ned.{axis}": fix[..., i] for i, axis in enumerate("xyz")}
    wind = {f"{name}_ned.{axis}": np.float32(0.1 * (i + 1)) * flat.astype(np.float32)
            for name in ("mean", "gust") for i, axis in enumerate("xyz")}  # fmt: skip
    return {
        "truth": {**truth, **attitude, "valid": flat > 0},
        "measurements": {**measured, "gps.satellites": (7 * flat).astype(np.float32)},
        "wind": wind,
    }


def write_run(
    folder: Path,
    *,
    ticks: int = TICKS,
    events: bool = True,
    end: str = "finished",
    start: str = START,
    longitude: float = LONGITUDE,
    scenario: str | None = None,
) -> Path:
    """Record two vehicles that move straight, in parts of PART ticks; events at ticks 13, 20 (of no vehicle) and 41."""
    info = RunInfo.collect(scenario="made_up", seed=5, precision="float64", time_step=STEP, vehicles=NAMES)
    site = f"{{latitude_deg: {LATITUDE}, longitude_deg: {longitude}, height: {HEIGHT}}}"
    scenario = f"start_time: '{start}'\nsite: {site}\nof_a_later_version: 1\n" if scenario is None else scenario
    writer = RunWriter.create(
        folder, info=info, scenario_yaml=scenario, columns=COLUMNS, flush_rows=10**9, flush_seconds=1e9
    )
    for first in range(0, ticks, PART):
        numbers = np.arange(first, min(first + PART, ticks))
        for stream, values in values_of(numbers).items():
            writer.append(stream, numbers, numbers * STEP, values)
        writer.flush()
    if events:
        writer.append_event(13 * STEP, 13, NAMES[0], "waypoint_reached", "waypoint", 1.0, 'reached <"1"> & on')
        writer.append_event(20 * STEP, 20, None, "clouds", None, float("nan"))
        writer.append_event(41 * STEP, 41, NAMES[1], "out_of_area", "position_ned.x", 123.5, "left the area")
    writer.flush()
    if end != "running":
        writer.close(end)  # type: ignore[arg-type]
    return folder


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that no test changes."""
    return write_run(tmp_path_factory.mktemp("export") / "run")


def export(folder: Path, form: str, *words: str) -> int:
    return cli.main(["export", str(folder), "--format", form, *words])


def exported(folder: Path, form: str, target: Path, *words: str) -> Path:
    assert export(folder, form, "--out", str(target), *words) == 0
    return target


def geodetic(position_ned: np.ndarray) -> tuple[float, float, float]:
    return pymap3d.ned2geodetic(*position_ned, LATITUDE, LONGITUDE, HEIGHT)


def reported(tick: int, vehicle: int) -> np.ndarray:
    return true_position(tick, vehicle) + 1.0


def near(found: tuple[float, ...], position_ned: np.ndarray) -> bool:
    """Latitude, longitude and height are where a NED position is, to a millimetre."""
    return bool(np.allclose(found, geodetic(position_ned), rtol=0.0, atol=[1e-8, 1e-8, 1e-3]))


def near_above_sea(point: ElementTree.Element, position_ned: np.ndarray) -> bool:
    """A point of GPX is where a NED position is, its height above the sea to a centimetre."""
    latitude, longitude, height = geodetic(position_ned)
    place = float(point.get("lat")) - latitude, float(point.get("lon")) - longitude
    ele = float(point.findtext("ele", None, GPX))
    return bool(np.allclose(place, 0.0, rtol=0.0, atol=1e-8) and abs(ele - (height - UNDULATION)) < 0.01)


def utc(tick: int) -> datetime:
    return START_UTC + timedelta(seconds=round(tick * STEP, 6))


# csv


def read_csv(path: Path) -> pa.Table:
    # NaN must come back as a number, and an empty field as null.
    return pacsv.read_csv(
        path,
        convert_options=pacsv.ConvertOptions(
            null_values=[""], strings_can_be_null=True, quoted_strings_can_be_null=False
        ),
    )


def test_csv_holds_every_stream_with_every_digit(recorded, tmp_path, capsys):
    folder = exported(recorded, "csv", tmp_path / "tables")
    run = open_run(recorded)
    assert sorted(path.name for path in folder.iterdir()) == ["events.csv", "measurements.csv", "truth.csv", "wind.csv"]
    for stream in run.streams:
        table, expected = read_csv(folder / f"{stream}.csv"), run.table(stream)
        units = run.units(stream)
        assert table.column_names == [f"{name} [{unit}]" if unit else name for name, unit in units.items()]
        assert table.column_names[0] == "time [s]"
        for name, column in zip(expected.column_names, table.columns, strict=True):
            if pa.types.is_floating(column.type):  # a float32 is written with the digits that give it back
                wanted = expected[name].to_numpy()
                assert np.array_equal(column.to_numpy().astype(wanted.dtype), wanted, equal_nan=True), name
            else:
                assert column.to_pylist() == expected[name].to_pylist(), name
    assert np.isnan(read_csv(folder / "measurements.csv")["gps.position_ned.x [m]"].to_numpy()).sum() == 20
    assert capsys.readouterr().out.splitlines() == [
        f"{folder / 'truth.csv'}: 120 rows",
        f"{folder / 'measurements.csv'}: 120 rows",
        f"{folder / 'wind.csv'}: 120 rows",
        f"{folder / 'events.csv'}: 3 rows",
    ]


def test_csv_of_one_stream_and_of_every_seventh_tick(recorded, tmp_path):
    table = read_csv(exported(recorded, "csv", tmp_path / "x.csv", "--stream", "truth", "--every", "7"))
    assert table["tick"].to_pylist() == [tick for tick in range(0, TICKS, 7) for _ in NAMES]
    assert table["vehicle"].to_pylist() == list(NAMES) * 9
    events = read_csv(exported(recorded, "csv", tmp_path / "y.csv", "--stream", "events", "--every", "7"))
    assert events["tick"].to_pylist() == [13, 20, 41]
    assert events["vehicle"].to_pylist() == [NAMES[0], None, NAMES[1]]
    assert events["message"].to_pylist()[0] == 'reached <"1"> & on'


# geojson


def features(path: Path, kind: str) -> list[dict[str, Any]]:
    content = json.loads(path.read_text(), parse_constant=pytest.fail)  # NaN is no JSON
    assert content["type"] == "FeatureCollection"
    return [item for item in content["features"] if kind in (item["properties"]["kind"], item["properties"]["feature"])]


def places(feature: dict[str, Any]) -> list[tuple[float, float, float]]:
    """Latitude, longitude, height of a feature's positions."""
    found = feature["geometry"]["coordinates"]
    return [(lat, lon, height) for lon, lat, height in (found if isinstance(found[0], list) else [found])]


def test_geojson_true_tracks(recorded, tmp_path):
    found = features(exported(recorded, "geojson", tmp_path / "x.geojson"), "true")
    assert [item["properties"]["name"] for item in found] == list(NAMES)
    for vehicle, item in enumerate(found):
        # By default, 5 Hz: every tenth tick of 0.02 s.
        assert item["geometry"]["type"] == "LineString"
        assert len(places(item)) == len(item["properties"]["times"]) == 6
        for tick, place, time in zip(range(0, TICKS, 10), places(item), item["properties"]["times"], strict=True):
            assert near(place, true_position(tick, vehicle))
            assert datetime.fromisoformat(time) == utc(tick)
        assert item["properties"]["start"] == item["properties"]["times"][0] == "2026-06-21T10:00:00.500000Z"
        assert item["properties"]["end"] == item["properties"]["times"][-1]


def test_geojson_reported_tracks_have_new_fixes_only_and_a_gap_where_there_are_none(recorded, tmp_path):
    found = features(exported(recorded, "geojson", tmp_path / "x.geojson", "--every", "1"), "gnss")
    assert {item["properties"]["sensor"] for item in found} == {"gps"}
    ticks = [[0, 10, 20, 30, 40, 50], [0, 10], [40, 50]]
    assert [item["properties"]["name"] for item in found] == [NAMES[0], NAMES[1], NAMES[1]]
    assert [item["properties"]["segment"] for item in found] == [0, 0, 1]
    for vehicle, item, expected in zip((0, 1, 1), found, ticks, strict=True):
        assert [datetime.fromisoformat(time) for time in item["properties"]["times"]] == [utc(t) for t in expected]
        assert all(near(place, reported(t, vehicle)) for t, place in zip(expected, places(item), strict=True))


def test_geojson_events_stand_where_the_vehicle_was(recorded, tmp_path, capsys):
    # None of their ticks is kept.
    path = exported(recorded, "geojson", tmp_path / "x.geojson", "--every", "11")
    reached, clouds, left = features(path, "event")
    assert near(places(reached)[0], true_position(13, 0))
    assert near(places(left)[0], true_position(41, 1))
    assert clouds["geometry"] is None
    assert clouds["properties"]["value"] is None
    assert left["properties"] == {
        "feature": "event", "name": "plain", "time": "2026-06-21T10:00:01.320000Z", "seconds": 41 * STEP, "tick": 41,
        "kind": "out_of_area", "field": "position_ned.x", "value": 123.5, "message": "left the area",
    }  # fmt: skip
    # 6 true points each; of the reports at these ticks, all of the first vehicle and 0, 11, 44, 55 of the other.
    assert capsys.readouterr().out == f"{path}: 22 points, 3 events\n"


def test_a_lone_position_is_a_point(tmp_path):
    folder = write_run(tmp_path / "run", ticks=1, events=False)
    found = features(exported(folder, "geojson", tmp_path / "x.geojson"), "true")
    assert [item["geometry"]["type"] for item in found] == ["Point", "Point"]
    assert near(places(found[1])[0], true_position(0, 1))


def test_a_track_is_cut_at_the_antimeridian(tmp_path):
    # The second vehicle starts 40 m east of 180 degrees and flies to the west of it.
    folder = write_run(tmp_path / "run", longitude=180.0)
    found = features(exported(folder, "geojson", tmp_path / "x.geojson", "--every", "1"), "true")
    east, west = [item for item in found if item["properties"]["name"] == "plain"]
    assert all(-180.0 <= place[1] < -179.9 for place in places(east))
    assert all(179.9 < place[1] <= 180.0 for place in places(west))
    assert len(places(east)) + len(places(west)) == TICKS


# gpx


def test_gpx(recorded, tmp_path, capsys):
    path = exported(recorded, "gpx", tmp_path / "x.gpx", "--every", "5")
    root = ElementTree.parse(path).getroot()
    assert root.tag == f"{{{GPX['']}}}gpx"
    assert root.get("version") == "1.1"
    tracks = root.findall("trk", GPX)
    assert [track.findtext("name", None, GPX) for track in tracks] == [
        f"{NAMES[0]} true", f"{NAMES[0]} gps", "plain true", "plain gps",
    ]  # fmt: skip
    counts = [[len(part) for part in track.findall("trkseg", GPX)] for track in tracks]
    assert counts == [[12], [6], [12], [2, 2]]
    for tick, point in zip((40, 50), tracks[3].findall("trkseg", GPX)[1], strict=True):
        assert near_above_sea(point, reported(tick, 1))
        assert datetime.fromisoformat(point.findtext("time", None, GPX)) == utc(tick)
    reached, left = root.findall("wpt", GPX)
    assert near_above_sea(left, true_position(41, 1))
    assert [child.tag.partition("}")[2] for child in left] == ["ele", "time", "name", "desc", "type"]
    assert reached.findtext("desc", None, GPX) == 'reached <"1"> & on'
    printed = capsys.readouterr()
    assert printed.out == f"{path}: 34 points, 2 events\n"
    # A waypoint needs a place.
    assert printed.err == f"warning: {path}: events of unknown place left out: 1\n"


# kml


def test_kml(recorded, tmp_path):
    root = ElementTree.parse(exported(recorded, "kml", tmp_path / "x.kml")).getroot()
    folders, [events] = root.findall("Document/Document", KML), root.findall("Document/Folder", KML)
    assert [folder.findtext("name", None, KML) for folder in folders] == list(NAMES)
    styles = {f"#{style.get('id')}": style for style in root.findall("Document/Document/Style", KML)}
    colours = set()
    for vehicle, folder in enumerate(folders):
        true, gps = folder.findall("Placemark", KML)
        used = [styles[placemark.findtext("styleUrl", None, KML)] for placemark in (true, gps)]
        colours |= {style.findtext("LineStyle/color", None, KML) for style in used}
        assert true.findtext("gx:MultiTrack/gx:Track/altitudeMode", None, KML) == "relativeToGround"
        (line,) = true.findall("gx:MultiTrack/gx:Track", KML)
        assert [datetime.fromisoformat(when.text) for when in line.findall("when", KML)] == [
            utc(tick) for tick in range(0, TICKS, 10)
        ]
        for tick, coord in zip(range(0, TICKS, 10), line.findall("gx:coord", KML), strict=True):
            longitude, latitude, height = map(float, coord.text.split(" "))
            # The site is 120 m above the ellipsoid, and its ground at z = 0.
            assert height == pytest.approx(20.0 + 0.1 * tick)
            _, _, above_ellipsoid = geodetic(true_position(tick, vehicle))
            assert near((latitude, longitude, above_ellipsoid), true_position(tick, vehicle))
        assert [len(part.findall("gx:coord", KML)) for part in gps.findall("gx:MultiTrack/gx:Track", KML)] == (
            [6] if vehicle == 0 else [2, 2]
        )
    assert len(colours) == 2
    reached, clouds, left = events.findall("Placemark", KML)
    longitude, latitude, height = map(float, left.findtext("Point/coordinates", None, KML).split(","))
    assert near((latitude, longitude, geodetic(true_position(41, 1))[2]), true_position(41, 1))
    assert height == pytest.approx(24.1)
    assert clouds.find("Point", KML) is None
    assert clouds.findtext("TimeStamp/when", None, KML) == "2026-06-21T10:00:00.900000Z"
    assert reached.findtext("description", None, KML) == 'reached <"1"> & on'


def test_kml_heights_above_the_ellipsoid_or_a_higher_ground(recorded, tmp_path, refused, capsys):
    def heights(folder: Path, *words: str) -> tuple[str, float]:
        root = ElementTree.parse(exported(folder, "kml", tmp_path / "h.kml", "--force", *words)).getroot()
        track = next(root.iter(f"{{{KML['gx']}}}Track"))
        return track.findtext("altitudeMode", None, KML), float(track.find("gx:coord", KML).text.split(" ")[2])

    mode, height = heights(recorded, "--heights", "ellipsoid")
    assert (mode, height) == ("absolute", pytest.approx(140.0, abs=1e-3))
    assert "<!-- Heights are above the WGS-84 ellipsoid. -->" in (tmp_path / "h.kml").read_text()
    mode, height = heights(recorded, "--heights", "sea")
    assert (mode, height) == ("absolute", pytest.approx(140.0 - UNDULATION, abs=0.01))
    assert (
        "<!-- Heights are above mean sea level, by the geoid of the scenario (EGM96 by default). -->"
        in (tmp_path / "h.kml").read_text()
    )
    site = f"site: {{latitude_deg: {LATITUDE}, longitude_deg: {LONGITUDE}, height: {HEIGHT}}}"
    content = f"start_time: '{START}'\n{site}\nworld: {{ground: {{type: flat, height: 5.0}}}}\n"
    mode, height = heights(write_run(tmp_path / "hill", scenario=content))
    assert (mode, height) == ("relativeToGround", pytest.approx(15.0))
    capsys.readouterr()
    words = ["export", str(recorded), "--format", "gpx", "--heights", "ellipsoid"]
    refused(words, "--heights ellipsoid: only kml has this choice; gpx has those above mean sea level")


def test_a_name_with_control_characters_is_refused(recorded, tmp_path, capsys):
    folder = tmp_path / "run"
    shutil.copytree(recorded, folder)
    content = json.loads((folder / "run.json").read_text()) | {"scenario": "bell \x07"}
    (folder / "run.json").write_text(json.dumps(content))
    assert cli.main(["export", str(folder), "--format", "gpx", "--out", str(tmp_path / "x")]) == 1
    assert "scenario: 'bell \\x07' is no name" in capsys.readouterr().err


# mcap

# Panels and choices that Foxglove, and Lichtblick, which goes on from its open source, read.
PANELS, STAMPS = {"3D", "map", "Plot", "RosOut"}, {"receiveTime", "headerStamp"}


def check_layout(layout: dict[str, Any], messages: dict[str, Any], schemas: dict[str, Any]) -> None:
    """Check that a layout can be read: all panels are placed and known, and all it shows is in the file."""
    panels = layout["configById"]

    def placed(node: Any) -> list[str]:
        if isinstance(node, str):
            return [node]
        assert node["direction"] in ("row", "column")
        assert 0 < node["splitPercentage"] < 100
        return placed(node["first"]) + placed(node["second"])

    assert sorted(placed(layout["layout"])) == sorted(panels)
    assert {name.partition("!")[0] for name in panels} <= PANELS
    for line in (line for name, panel in panels.items() if name.startswith("Plot!") for line in panel["paths"]):
        topic, *fields = line["value"].split(".")
        found = messages[topic][0][1]
        # A header's stamp needs a header; without it a plot stays empty.
        assert line["timestampMethod"] in STAMPS - ({"headerStamp"} if "header" not in found else set())
        for field in fields:
            found = found[field]
        assert isinstance(found, float)
    assert schemas[panels["RosOut!events"]["topicToRender"]] == "foxglove.Log"
    assert schemas["/scene"] == "foxglove.SceneUpdate"


def read_mcap(path: Path) -> tuple[dict[str, list[tuple[int, dict[str, Any]]]], dict[str, Any]]:
    """Return topic -> [(time, content)], and topic -> schema."""
    messages: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    schemas: dict[str, Any] = {}
    with open(path, "rb") as file:
        # In the order of the file, which is that of time.
        last = 0
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            assert message.log_time >= last
            last = message.log_time
            assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
            content = json.loads(message.data, parse_constant=pytest.fail)
            declared = json.loads(schema.data)
            assert declared["title"] == schema.name
            assert content.keys() <= declared["properties"].keys()
            time = content["timestamp"]
            assert time["sec"] * 10**9 + time["nsec"] == message.log_time == message.publish_time
            messages.setdefault(channel.topic, []).append((message.log_time, content))
            schemas[channel.topic] = schema.name
    return messages, schemas


def nanoseconds(tick: int) -> int:
    return round(utc(tick).timestamp() * 1e6) * 1000


def test_mcap_topics_counts_and_times(recorded, tmp_path, capsys):
    path = exported(recorded, "mcap", tmp_path / "x.mcap")
    messages, schemas = read_mcap(path)
    odd = "a%2Fb%20%3C%22%C3%A9%22%3E%26"
    assert schemas == {
        "/tf": "foxglove.FrameTransform",
        "/events": "foxglove.Log",
        **{f"/{name}/pose": "foxglove.PoseInFrame" for name in (odd, "plain")},
        **{f"/{name}/location": "foxglove.LocationFix" for name in (odd, "plain")},
        **{f"/{name}/gps/fix": "foxglove.LocationFix" for name in (odd, "plain")},
        **{f"/{name}/wind": "qrsim.Wind" for name in (odd, "plain")},
        **{f"/{name}/gps": "qrsim.gps" for name in (odd, "plain")},
    }
    assert [time for time, _ in messages["/plain/pose"]] == [nanoseconds(tick) for tick in range(TICKS)]
    assert [time for time, _ in messages["/plain/gps/fix"]] == [nanoseconds(tick) for tick in (0, 10, 40, 50)]
    assert len(messages["/tf"]) == 2 * TICKS
    total = sum(map(len, messages.values()))
    # Six readings of the one that keeps its fix; of the other at ticks 0, 10, 20 (lost: satellites only), 40, 50.
    assert [time for time, _ in messages["/plain/gps"]] == [nanoseconds(tick) for tick in (0, 10, 20, 40, 50)]
    assert total == 2 * TICKS * 4 + 6 + 4 + 3 + 6 + 5
    assert capsys.readouterr().out == f"{path}: {total} messages\n"
    with open(path, "rb") as file:
        reader = make_reader(file)
        assert reader.get_summary().statistics.message_count == total
        (origin,) = [item.metadata for item in reader.iter_metadata()]
    assert (origin["scenario"], origin["seed"]) == ("made_up", "5")
    assert math.isclose(float(origin["origin_latitude_deg"]), LATITUDE, abs_tol=1e-12)


def test_mcap_poses_are_east_north_up(recorded, tmp_path):
    messages, _ = read_mcap(exported(recorded, "mcap", tmp_path / "x.mcap", "--every", "10"))
    _, content = messages["/plain/pose"][3]
    north, east, down = true_position(30, 1)
    pose = content["pose"]
    assert content["frame_id"] == "map"
    assert [pose["position"][axis] for axis in "xyz"] == pytest.approx([east, north, -down])
    # An independent rotation: body axes forward, right, down in north, east, down, by the angles that were recorded.
    ned = scipy.spatial.transform.Rotation.from_euler("ZYX", [0.3, 0.2, 0.1]).as_matrix()
    enu_of_ned, frd_of_flu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]), np.diag([1, -1, -1])
    found = scipy.spatial.transform.Rotation.from_quat([pose["orientation"][axis] for axis in "xyzw"]).as_matrix()
    assert np.allclose(found, enu_of_ned @ ned @ frd_of_flu, atol=1e-12)
    frame = [item for _, item in messages["/tf"] if item["child_frame_id"] == "plain"][3]
    assert frame["parent_frame_id"] == "map"
    assert (frame["translation"], frame["rotation"]) == (pose["position"], pose["orientation"])


def check_all_of_a_run(run: Any, path: Path) -> None:
    """A patrol's file has all that was logged and all that its scenario says."""
    messages, schemas = read_mcap(path)
    name = run.vehicles[0]
    sensors = ("gnss", "barometer", "imu", "magnetometer")
    words = ("pose", "location", "wind", "gnss/fix", "command", "setpoint", "estimate", "waypoints", *sensors)
    assert set(schemas) == {"/tf", "/events", "/scene"} | {f"/{own}/{word}" for own in run.vehicles for word in words}
    first = messages[f"/{name}/setpoint"][0][1]
    assert [first["position_ned"][axis] for axis in "xyz"] == [-60.0, -20.0, -20.0]
    command = messages[f"/{name}/command"][5][1]
    assert command["throttle"] == pytest.approx(run["commands"]["throttle"][5, 0])
    assert command["clipped"] is False
    assert command["waypoint"] == 0
    barometer = messages[f"/{name}/barometer"]
    assert barometer[7][1]["height"] == pytest.approx(run["measurements"]["barometer.height"][7, 0])
    # By the accuracies that the receiver states: 0.7 m and 1.3 m are those of its class in the open.
    fix = messages[f"/{name}/gnss/fix"][0][1]
    level, down = (float(run["measurements"][f"gnss.{axis}_accuracy"][0, 0]) for axis in ("horizontal", "vertical"))
    assert 0.3 < level < 2.0
    assert [fix["position_covariance"][i] for i in (0, 4, 8)] == pytest.approx([level**2 / 2, level**2 / 2, down**2])
    assert sum(map(bool, fix["position_covariance"])) == 3
    assert fix["position_covariance_type"] == 1
    route = messages[f"/{name}/waypoints"][0][1]["poses"]
    assert [tuple(pose["position"].values()) for pose in route][:2] == [(-20.0, -60.0, 20.0), (-20.0, -20.0, 20.0)]
    entities = {entity["id"]: entity for entity in messages["/scene"][0][1]["entities"]}
    assert set(entities) == {"area"} | {f"waypoints {own}" for own in run.vehicles}
    corners = {tuple(point.values()) for line in entities["area"]["lines"] for point in line["points"]}
    assert corners == {(east, north, up) for east in (-200, 200) for north in (-200, 200) for up in (0, 100)}
    layout = json.loads(path.with_name("first.layout.json").read_text())
    panels = set(layout["configById"])
    assert {"3D!space", "map!place", "Plot!height", "RosOut!events"} <= panels
    plotted = [line["value"] for line in layout["configById"]["Plot!height"]["paths"]]
    assert plotted == [f"/{own}/pose.pose.position.z" for own in run.vehicles]
    assert set(layout["configById"]["3D!space"]["topics"]) <= set(schemas)
    check_layout(layout, messages, schemas)


@pytest.mark.long
def test_mcap_has_the_estimate_of_a_filter(tmp_path):
    folder = tmp_path / "run"
    words = ["--duration", "0.2", "--set", "fleets.pelicans.controller={type: cascade}", "--no-figure"]
    assert cli.main(["run", "patrol_plain", *words, "--out", str(folder)]) == 0
    messages, schemas = read_mcap(exported(folder, "mcap", tmp_path / "x.mcap"))
    assert schemas["/pelicans_0/estimate"] == "qrsim.estimate"
    # The range errors have a std of 1.5 m, the receiver's own of 0.02 m: 2.2504 m^2 together.
    run = open_run(folder)
    fix = messages["/pelicans_0/gnss/fix"][0][1]
    hdop, vdop = (float(run["measurements"][f"gnss.{axis}dop"][0, 0]) for axis in "hv")
    diagonal = [fix["position_covariance"][i] for i in (0, 4, 8)]
    assert diagonal == pytest.approx([1.1252 * hdop**2, 1.1252 * hdop**2, 2.2504 * vdop**2])
    _, last = messages["/pelicans_0/estimate"][-1]
    # Five vehicles start still at known places; GNSS and barometer are off by a few metres at most.
    assert [last["position_ned"][axis] for axis in "xyz"] == pytest.approx([-60.0, -60.0, -20.0], abs=6.0)
    assert set(last) == {"timestamp", "position_ned", "velocity_ned", "attitude"}


def test_mcap_scene_has_obstacles_persons_and_places(tmp_path):
    mast = {"radius": 2.0, "x": 10.0, "y": 20.0, "z_min": -30.0, "z_max": 0.0}
    shed = {"x_min": 0.0, "x_max": 4.0, "y_min": 10.0, "y_max": 20.0, "z_min": -6.0, "z_max": 0.0}
    around = Surroundings(
        obstacles=(mast, shed), persons=np.array([[1.0, 2.0], [3.0, 4.0]]), found=np.array([np.inf, 0.5]),
        sources=np.array([[5.0, 6.0, -7.0]]), locations=np.array([[8.0, 9.0, -1.0]]),
    )  # fmt: skip
    run = open_run(write_run(tmp_path / "run"))
    begin, later = scene(run, place_of(run), around, "map")
    found = {entity["id"]: entity for entity in begin.content["entities"]}
    assert set(found) == {"obstacle 0", "obstacle 1", "source 0", "asked for", "person 0", "person 1"}
    [cylinder], [box] = found["obstacle 0"]["cylinders"], found["obstacle 1"]["cubes"]
    assert cylinder["pose"]["position"] == {"x": 20.0, "y": 10.0, "z": 15.0}
    assert cylinder["size"] == {"x": 4.0, "y": 4.0, "z": 30.0}
    assert (box["pose"]["position"], box["size"]) == ({"x": 15.0, "y": 2.0, "z": 3.0}, {"x": 10.0, "y": 4.0, "z": 6.0})
    assert found["source 0"]["spheres"][0]["pose"]["position"] == {"x": 6.0, "y": 5.0, "z": 7.0}
    [entity] = later.content["entities"]
    assert (entity["id"], later.time_ns) == ("person 1", begin.time_ns + 500_000_000)
    assert entity["spheres"][0]["color"] != found["person 1"]["spheres"][0]["color"]


def test_mcap_places_wind_and_events(recorded, tmp_path):
    messages, _ = read_mcap(exported(recorded, "mcap", tmp_path / "x.mcap"))
    for topic, index, position in (
        ("/plain/location", 30, true_position(30, 1)),
        ("/plain/gps/fix", 2, reported(40, 1)),
    ):
        fix = messages[topic][index][1]
        assert near((fix["latitude"], fix["longitude"], fix["altitude"]), position)
        assert (fix["frame_id"], fix["position_covariance_type"]) == ("plain", 0)
    wind = messages["/plain/wind"][0][1]
    assert [wind["mean_ned"][axis] for axis in "xyz"] == pytest.approx([0.1, 0.2, 0.3])
    assert wind["gust_ned"] == wind["mean_ned"]
    found = [(time, item["level"], item["name"], item["kind"], item["message"], item.get("value"))
             for time, item in messages["/events"]]  # fmt: skip
    assert found == [
        (nanoseconds(13), 2, NAMES[0], "waypoint_reached", 'reached <"1"> & on', 1.0),
        (nanoseconds(20), 4, "", "clouds", "clouds", None),
        (nanoseconds(41), 4, "plain", "out_of_area", "left the area", 123.5),
    ]


# every format


@pytest.mark.long
@pytest.mark.parametrize("form", ["csv", "geojson", "gpx", "kml", "mcap"])
def test_a_flown_run_in_its_default_place(form, flown, tmp_path, capsys):
    folder = tmp_path / "first"
    shutil.copytree(flown.folder, folder)
    assert export(folder, form, "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["run"], said["format"], said["every"]) == (str(folder), form, 1 if form in ("csv", "mcap") else 10)
    run = open_run(folder)
    names = [f"{stream}.csv" for stream in run.streams] if form == "csv" else [f"first.{form}"]
    assert [item["path"] for item in said["files"]] == [str(folder / "export" / name) for name in names]
    names += ["first.layout.json"] if form == "mcap" else []
    assert sorted(path.name for path in (folder / "export").iterdir()) == sorted(names)
    ticks, vehicles = len(run["truth"].time), len(run.vehicles)
    fixes = 10.0 / 0.2  # the receiver's first report is repeated once
    if form == "csv":
        expected = [run.table(stream).num_rows for stream in run.streams]
        assert [item["rows"] for item in said["files"]] == expected
    elif form == "mcap":
        check_all_of_a_run(run, folder / "export" / "first.mcap")
    else:
        assert said["files"][0]["points"] == vehicles * (math.ceil(ticks / 10) + fixes)
        assert said["files"][0]["events"] == len(run.events)


def test_nothing_is_overwritten_unasked(recorded, tmp_path, refused, capsys):
    target = tmp_path / "x.kml"
    target.write_text("mine")
    refused(["export", str(recorded), "--format", "kml", "--out", str(target)], f"{target} exists", "--force")
    assert target.read_text() == "mine"
    assert export(recorded, "kml", "--out", str(target), "--force") == 0
    assert ElementTree.parse(target).getroot().tag.endswith("kml")
    # One of several: none is written.
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "wind.csv").write_text("mine")
    capsys.readouterr()
    refused(["export", str(recorded), "--format", "csv", "--out", str(tmp_path / "tables")], "wind.csv exists")
    assert [path.name for path in (tmp_path / "tables").iterdir()] == ["wind.csv"]


def test_wrong_usage(recorded, tmp_path, refused):
    def check(form: str, *words: str, parts: tuple[str, ...], folder: Path = recorded) -> None:
        refused(["export", str(folder), "--format", form, *words], *parts)

    check("csv", "--stream", "trut", parts=("has no stream 'trut'; did you mean 'truth'?",))
    check("csv", "--every", "0", parts=("--every 0: expected an integer from 1",))
    check("csv", "--every", "9" * 30, parts=("expected an integer from 1 to 2**31 - 1",))
    check("gpx", "--stream", "truth", parts=("--stream chooses among the tables of csv; gpx",))
    check("gpx", "--out", str(tmp_path), "--force", parts=(f"{tmp_path} is a folder",))
    (tmp_path / "x.csv").touch()
    check("csv", "--out", str(tmp_path / "x.csv"), "--force", parts=("x.csv is a file", "--stream"))
    check("csv", parts=("is not a run folder",), folder=tmp_path)
    check("csv", parts=("no run at",), folder=tmp_path / "nothing")
    assert not (recorded / "export").exists()


def test_unknown_and_missing_formats(recorded, capsys):
    assert export(recorded, "xls") == 2
    assert "mcap" in capsys.readouterr().err
    assert cli.main(["export", str(recorded)]) == 2
    assert "--format" in capsys.readouterr().err


def test_a_target_that_cannot_be_written(recorded, tmp_path, refused):
    (tmp_path / "file").touch()
    target = tmp_path / "file" / "x.gpx"
    refused(["export", str(recorded), "--format", "gpx", "--out", str(target)], f"cannot write {target}: ", code=1)


def test_a_scenario_that_names_no_place_or_a_time_that_mcap_cannot_say(tmp_path, refused):
    nowhere = write_run(tmp_path / "nowhere", scenario="start_time: 2026-01-01T00:00:00Z\n")
    refused(["export", str(nowhere), "--format", "gpx"], "scenario.yaml does not say where", "site", code=1)
    broken = write_run(tmp_path / "broken", scenario="site: {\n")
    refused(["export", str(broken), "--format", "mcap"], "scenario.yaml", "line", code=1)
    assert export(nowhere, "csv") == 0  # which needs none
    for name, start in (("old", "1969-12-31T23:00:00Z"), ("late", "2600-01-01T00:00:00Z")):
        folder = write_run(tmp_path / name, start=start)
        assert export(folder, "gpx") == 0
        assert start[:10] in (folder / "export" / f"{name}.gpx").read_text()


@pytest.mark.parametrize("start", ["1969-12-31T23:00:00Z", "2600-01-01T00:00:00Z"])
def test_times_that_mcap_cannot_say(start, tmp_path, refused):
    folder = write_run(tmp_path / "run", start=start)
    refused(["export", str(folder), "--format", "mcap"], "start_time is outside 1970 to 2106", code=1)


# unfinished and damaged runs


@pytest.mark.parametrize("end", ["interrupted", "failed"])
def test_a_run_that_ended_early(end, tmp_path, capsys):
    folder = write_run(tmp_path / "run", end=end)
    path = exported(folder, "geojson", tmp_path / "x.geojson")
    assert capsys.readouterr().err == ""
    assert [len(places(item)) for item in features(path, "true")] == [6, 6]


ENDS = "the data end at its last flush"


def test_a_run_killed_while_its_last_parts_were_written(tmp_path, capsys):
    folder = write_run(tmp_path / "run", end="running")
    # The true motion was on disk already, the rest was not; run.json speaks of the flush before.
    for stream in ("measurements", "wind"):
        (folder / stream / "part-00003.parquet").unlink()
    content = json.loads((folder / "run.json").read_text())
    content["parts"] = dict.fromkeys(content["parts"], 3) | {"events": 1}
    (folder / "run.json").write_text(json.dumps(content))
    path = exported(folder, "geojson", tmp_path / "x.geojson")
    assert [len(places(item)) for item in features(path, "true")] == [6, 6]
    assert [len(places(item)) for item in features(path, "gnss")] == [4, 2]
    messages, _ = read_mcap(exported(folder, "mcap", tmp_path / "x.mcap"))
    assert (len(messages["/plain/pose"]), len(messages["/plain/wind"])) == (60, 40)
    # Once for each command.
    assert capsys.readouterr().err == 2 * f"{folder}: the run has not ended, or was killed; {ENDS}\n"


@pytest.mark.parametrize("form", ["geojson", "gpx", "kml", "mcap"])
def test_a_run_without_a_tick(form, tmp_path, refused):
    folder = write_run(tmp_path / "run", **NOTHING, end="running")
    refused(["export", str(folder), "--format", form], "no tick was recorded (state: running)", code=1)
    assert not (folder / "export").exists() or list((folder / "export").iterdir()) == []
    assert export(folder, "csv") == 0
    assert read_csv(folder / "export" / "truth.csv").num_rows == 0


def test_a_damaged_part_is_left_out_with_a_warning_and_a_gap(tmp_path, capsys):
    folder = write_run(tmp_path / "run")
    damaged = folder / "truth" / "part-00002.parquet"
    damaged.write_bytes(damaged.read_bytes()[:-20])
    path = exported(folder, "geojson", tmp_path / "x.geojson")
    printed = capsys.readouterr()
    assert "warning: left out: " in printed.err
    assert "truth/part-00002.parquet" in printed.err
    true = features(path, "true")
    # Of ticks 0 to 59, those from 20 to 39 are lost: the line does not lead across.
    assert [(item["properties"]["name"], len(places(item))) for item in true] == [
        (NAMES[0], 2), (NAMES[0], 2), (NAMES[1], 2), (NAMES[1], 2),
    ]  # fmt: skip
    assert near(places(true[1])[0], true_position(40, 0))
    # The place of an event in the lost part is unknown now; the receiver's reports are all there.
    assert [item["geometry"] is None for item in features(path, "event")] == [False, True, False]
    assert [len(places(item)) for item in features(path, "gnss")] == [6, 2, 2]


def test_a_stream_of_which_nothing_is_left(tmp_path, capsys, refused):
    folder = write_run(tmp_path / "run")
    shutil.rmtree(folder / "measurements")
    path = exported(folder, "geojson", tmp_path / "x.geojson")
    assert "measurements: no part can be read" in capsys.readouterr().err
    assert len(features(path, "true")) == 2
    assert features(path, "gnss") == []
    assert exported(folder, "csv", tmp_path / "tables")
    assert not (tmp_path / "tables" / "measurements.csv").exists()
    assert export(folder, "csv", "--stream", "measurements") == 1
    assert "measurements: no part can be read" in capsys.readouterr().err
