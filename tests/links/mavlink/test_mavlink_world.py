"""Vehicles of a scenario on the wire: what they send is what they see, and one is flown alone."""

import asyncio
import math
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from qrsim.links.mavlink import ports
from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.dialogue import handle
from qrsim.links.mavlink.fleet import prepared
from qrsim.links.mavlink.frames import Frame, Reader
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.server import Server, Wire
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.streams import Streams
from qrsim.links.mavlink.telemetry import ENCODERS
from qrsim.links.mavlink.world import FlownWorld
from qrsim.scenarios.scenario import load_scenario

NAN = math.nan
CONTENT = {
    "name": "two",
    "duration": 60.0,
    "start_time": "2026-06-21T10:00:00Z",
    "site": {"latitude_deg": 51.7, "longitude_deg": -0.2, "height": 40.0},
    "world": {"wind": {"type": "log_shear", "speed_20ft": 3.0, "wind_from_deg": 270}},
    "fleets": {
        "pair": {
            # Their own controller takes no paths, and they start in the air.
            "controller": {"type": "waypoint", "feed": "truth"},
            "battery": {"type": "lithium_polymer"},
            "sensors": {
                "gnss": {"type": "gnss_receiver"},
                "barometer": {"type": "barometer"},
                "gyroscope": {"type": "gyroscope"},
                "accelerometer": {"type": "accelerometer"},
            },
            "vehicles": [
                {"position_ned": [0, 0, -20], "waypoints_ned": [[9, 0, -20]]},
                {"position_ned": [5, 0, -20]},
            ],
        },
    },
}
EVERYTHING = dict.fromkeys(
    ("HEARTBEAT", "SYS_STATUS", "GPS_RAW_INT", "ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "HIGHRES_IMU",
     "SYSTEM_TIME", "BATTERY_STATUS", "EXTENDED_SYS_STATE", "HIL_STATE_QUATERNION", "ATTITUDE_QUATERNION"), 50.0,
)  # fmt: skip


# Height of EGM96 above the ellipsoid at the site [m], 46.25 to 46.27 within a kilometre.
GEOID = 46.261


class Air:
    """The world, and what each vehicle sends."""

    def __init__(self, datum="sea"):
        scenario = prepared(load_scenario(CONTENT))
        self.world = FlownWorld(scenario, FlightStack, seed=4, first_system=7, truth=True, datum=datum)
        self.sent = {system.number: [] for system in self.world.systems}
        for system in self.world.systems:
            streams = Streams(EVERYTHING, 0.02)
            system.links.append(Link(system.number, streams, self.sent[system.number].append))

    def run(self, ticks):
        """Return the last message of each name from the first vehicle."""
        found = {}
        for _ in range(ticks):
            for sent in self.sent.values():
                sent.clear()
            self.world.tick(0.0)
            for data in self.sent[7]:
                found |= {read.layout.name: read.message() for read in Reader().datagram(data)}
        return found

    def ask(self, system, name, **values):
        layout = LAYOUTS[name]
        data = Frame(layout, layout.payload(**values), 0, 245, 190, 2)
        for each in self.world.systems:
            handle(each, each.links[0], data)

    def command(self, system, number, *params):
        values = {f"param{i}": value for i, value in enumerate((*params, *[NAN] * (7 - len(params))), 1)}
        self.ask(system, "COMMAND_LONG", target_system=system, target_component=1, command=number, **values)


@pytest.fixture(scope="module")
def air():
    return Air()


def test_the_local_frame_of_each_begins_where_it_stood(air):
    """Each is at (0, 0, 0), and GPS_GLOBAL_ORIGIN is there: the second stands 5 m north of the first."""
    air.run(1)
    places = []
    for system, sent in air.sent.items():
        sent.clear()
        for number in (32.0, 49.0, 242.0):
            air.command(system, 512, number)
        local, origin, home = (
            read.message()
            for data in sent
            for read in Reader().datagram(data)
            if read.layout.name in ("LOCAL_POSITION_NED", "GPS_GLOBAL_ORIGIN", "HOME_POSITION")
        )
        assert (local.x, local.y, local.z) == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
        assert (home.x, home.y, home.z) == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
        assert (origin.latitude, origin.longitude) == pytest.approx((home.latitude, home.longitude), abs=1.0)
        places.append(origin)
    # A degree of latitude is 111 252 m at 51.7 degrees (WGS-84).
    assert places[1].latitude - places[0].latitude == pytest.approx(5.0 / 111252.0 * 1e7, abs=2.0)
    assert places[1].longitude == pytest.approx(places[0].longitude, abs=1.0)


def test_one_is_flown_and_the_other_one_stays(air):
    first, second = air.world.systems
    assert (first.number, first.name, second.number) == (7, "pair_0", 8)
    assert air.world.simulation.truth.on_ground.tolist() == [True, True]
    air.run(100)
    air.command(7, 400, 1.0)
    air.command(7, 22, NAN, NAN, NAN, NAN, NAN, NAN, 45.0 - GEOID)
    found = air.run(400)
    height = -air.world.simulation.truth.position_ned[:, 2]
    # The site is 40 m above the ellipsoid, and the take-off to 45 m.
    assert height == pytest.approx([5.0, 0.0], abs=0.4)
    assert found["EXTENDED_SYS_STATE"].landed_state == 2
    assert found["HEARTBEAT"].base_mode & 128
    assert second.stack.armed is False


def test_what_is_sent_is_what_is_seen(air):
    found, simulation = air.run(20), air.world.simulation
    reading, truth = simulation.reading["pair"], simulation.truth
    single = lambda value: struct.unpack("<f", struct.pack("<f", value))[0]  # noqa: E731
    imu = found["HIGHRES_IMU"]
    assert (imu.xacc, imu.yacc, imu.zacc) == tuple(map(single, reading.accelerometer.specific_force[0]))
    assert (imu.xgyro, imu.ygyro, imu.zgyro) == tuple(map(single, reading.gyroscope.rates_body[0]))
    # Acceleration, rates and pressure altitude; no magnetometer and no pressure.
    assert imu.fields_updated == 0x7 | 0x38 | 0x800
    gps = found["GPS_RAW_INT"]
    assert (gps.lat, gps.lon) == pytest.approx(
        (reading.gnss.latitude_deg[0] * 1e7, reading.gnss.longitude_deg[0] * 1e7), abs=1.0
    )
    assert gps.alt_ellipsoid == pytest.approx(reading.gnss.height[0] * 1e3, abs=1.0)
    assert (gps.satellites_visible, gps.fix_type) == (reading.gnss.satellites[0], 3)
    assert gps.eph == round(reading.gnss.hdop[0] * 100)
    local, place = found["LOCAL_POSITION_NED"], found["GLOBAL_POSITION_INT"]
    # This controller is fed with the truth, of the tick before; its local frame began at the site.
    assert (local.x, local.y, local.z) == pytest.approx(truth.position_ned[0], abs=0.05)
    latitude, longitude, height = simulation.site.ned_to_geodetic([local.x, local.y, local.z])
    assert (place.lat, place.lon) == pytest.approx((np.degrees(latitude) * 1e7, np.degrees(longitude) * 1e7), abs=1.0)
    assert place.alt == pytest.approx((float(height) - GEOID) * 1e3, abs=2.0)
    # Noon is two hours later.
    assert found["SYSTEM_TIME"].time_unix_usec == pytest.approx(1_782_036_000e6 + simulation.time * 1e6, abs=1.0)
    assert found["SYSTEM_TIME"].time_boot_ms == round(simulation.time * 1e3)
    battery, status = found["BATTERY_STATUS"], found["SYS_STATUS"]
    assert 11_000 < battery.voltages[0] < 12_000
    assert 97 <= battery.battery_remaining <= 99
    # Gyroscope, accelerometer, barometer and GNSS are there and well; there is no magnetometer.
    assert status.onboard_control_sensors_health & 0x2F == 0x2B
    true = found["HIL_STATE_QUATERNION"]
    assert true.lat == pytest.approx(
        np.degrees(simulation.site.ned_to_geodetic(truth.position_ned[0])[0]) * 1e7, abs=1.0
    )
    roll, pitch, yaw = (getattr(found["ATTITUDE"], name) for name in ("roll", "pitch", "yaw"))
    w, x, y, z = (getattr(found["ATTITUDE_QUATERNION"], f"q{i}") for i in range(1, 5))
    assert 2.0 * (w * y - z * x) == pytest.approx(math.sin(pitch), abs=1e-6)
    assert math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)) == pytest.approx(roll, abs=1e-6)
    assert math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)) == pytest.approx(yaw, abs=1e-6)


def test_altitudes_are_above_the_sea_or_the_ellipsoid(air):
    """The site is 40 m above the ellipsoid, which is -6.26 m above the sea."""
    air.run(20)
    for world, above in ((air.world, GEOID), (Air("ellipsoid").world, 0.0)):
        world.tick(0.0)
        view = world.systems[0].view
        north_east_down = world.simulation.truth.position_ned[0]

        def said(name, view=view):
            layout = LAYOUTS[name]
            return Frame(layout, ENCODERS[layout.number](view), 0, 1, 1, 2).message()

        gps, place, home = said("GPS_RAW_INT"), said("GLOBAL_POSITION_INT"), said("HOME_POSITION")
        assert gps.alt_ellipsoid - gps.alt == pytest.approx(1e3 * above, abs=2.0)
        # Near the site the curvature of the Earth lifts nothing.
        height = 40.0 - view.seen.position_ned[2]
        assert place.alt == pytest.approx(1e3 * (height - above), abs=2.0)
        assert said("VFR_HUD").alt == pytest.approx(height - above, abs=2e-3)
        assert said("ALTITUDE").altitude_amsl == pytest.approx(height - above, abs=2e-3)
        assert said("HIL_STATE_QUATERNION").alt == pytest.approx(1e3 * (40.0 - north_east_down[2] - above), abs=2.0)
        origin = world.systems[0].stack.origin
        assert said("GPS_GLOBAL_ORIGIN").altitude == pytest.approx(1e3 * (40.0 - origin[2] - above), abs=2.0)
        assert home.altitude == pytest.approx(1e3 * (40.0 - above), abs=500.0)
        assert place.alt - place.relative_alt == pytest.approx(home.altitude, abs=2.0)
        # A place 50 m above the one or the other, seen from the site.
        assert world.systems[0].stack.craft.geodesy.to_ned(51.7, -0.2, 50.0)[2] == pytest.approx(
            -10.0 - above, abs=2e-3
        )


def test_over_loopback_by_udp_and_tcp(air):
    """A program hears the vehicle that it speaks to by UDP, and all by TCP; pymavlink reads every frame."""
    found = ports.opened(2, ports.HERE, True, False)
    taken = ports.opened(2, ports.HERE, True, False)
    assert (taken.block, taken.onboard, taken.tcp) == (found.block + 1, found.onboard + 100, found.tcp + 10)
    taken.close()
    lines: list[str] = []

    async def talk():
        server = Server(air.world, found, Wire(factor=2.0), lines.append)
        serving = asyncio.create_task(server.serve())
        await asyncio.sleep(0.05)
        loop = asyncio.get_running_loop()
        heard: list[bytes] = []

        class Client(asyncio.DatagramProtocol):
            def datagram_received(self, data, address):
                heard.append(data)

        transport, _ = await loop.create_datagram_endpoint(Client, remote_addr=(ports.HERE, found.onboard + 1))
        reader, writer = await asyncio.open_connection(ports.HERE, found.tcp)
        sender = common.MAVLink(None, 245, 190)
        transport.sendto(common.MAVLink_ping_message(1, 2, 0, 0).pack(sender))
        writer.write(common.MAVLink_param_request_read_message(8, 1, b"GF_ACTION", -1).pack(sender))
        await asyncio.sleep(0.5)
        tcp = await reader.read(1 << 20)
        writer.close()
        transport.close()
        serving.cancel()
        return b"".join(heard), tcp

    try:
        udp, tcp = asyncio.run(talk())
    finally:
        found.close()
    assert lines == []
    by_udp = common.MAVLink(None).parse_buffer(udp)
    assert {message.get_srcSystem() for message in by_udp} == {8}
    (ping,) = (message for message in by_udp if message.get_type() == "PING")
    assert (ping.seq, ping.target_system) == (2, 245)
    by_tcp = common.MAVLink(None).parse_buffer(tcp)
    assert {message.get_srcSystem() for message in by_tcp} == {7, 8}
    (value,) = (message for message in by_tcp if message.get_type() == "PARAM_VALUE")
    assert (value.get_srcSystem(), value.param_id) == (8, "GF_ACTION")
    assert not [message for message in by_udp + by_tcp if message.get_type() == "BAD_DATA"]
