"""Flight stacks fly simulated vehicles in a wind of 6 m/s, on noisy sensors."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

import qrsim
from qrsim.links.mavlink.stack.codes import MissionState, PlanKind, PlanResult
from qrsim.links.mavlink.stack.contracts import NAN, AttitudeTarget, Command, Facts, FollowTarget, Item, Seen
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.links.shared.latches import Latches
from qrsim.models.geoid import undulation

pytestmark = pytest.mark.long
PARKED = """
name: parked
duration: 300.0
world:
  wind: {type: log_shear, speed_20ft: 6.0, wind_from_deg: 225}
  turbulence: {type: dryden}
  sky: {errors: {type: ou, std: 1.5, time_constant: 2000.0}}
fleets:
  pelicans:
    ground: parked
    controller: {type: cascade}
    sensors:
      gnss: {type: gnss_receiver, range_noise_std: 0.02}
      barometer: {type: barometer}
      attitude: {type: attitude_estimator}
      accelerometer: {type: accelerometer}
    vehicles: [{position_ned: [0, 0, 0]}, {position_ned: [0, 6, 0]}]
"""


class Field:
    """A simulation whose vehicles are flown by their stacks."""

    def __init__(self, scenario: str = "mavlink_field", seed: int = 3):
        self.simulation = qrsim.load(scenario, seed=seed)
        self.simulation.reset()
        fleet = self.simulation.world.fleets[0]
        handling = fleet.vehicle.handling()
        self.latches = Latches(self.simulation.world.fleets, self.simulation.dtype)
        gain = float(handling.tilt_gain)
        self.stacks = [
            FlightStack(
                Facts(
                    name,
                    number + 1,
                    self.simulation.world.time_step,
                    tilt_max=float(np.max(handling.tilt_max)),
                    hover_throttle=float(handling.throttle(handling.mass * handling.gravity)),
                    roll_gain=gain,
                    pitch_gain=gain,
                ),
                self.simulation.site,
            )
            for number, name in enumerate(self.simulation.vehicle_names)
        ]
        self.said: list[str] = []
        self.reached: list[int] = []
        self.run(2.0)

    def see(self) -> list[Seen]:
        """What each vehicle believes of itself."""
        simulation = self.simulation
        state = simulation.state.fleets[0]
        believed = state.belief.estimate
        columns = (believed.position_ned, believed.velocity_ned)
        place, speed = (np.stack([np.float64(getattr(part, axis)) for axis in "xyz"], 1) for part in columns)
        angles = np.stack([np.float64(getattr(believed.attitude, axis)) for axis in ("roll", "pitch", "yaw")], 1)
        latitude, longitude, height = simulation.site.ned_to_geodetic(place)
        altitude = height - (simulation.site.height - self.height)
        charge = getattr(state.battery, "charge", np.full(len(place), NAN))
        standing, reasons = simulation.truth.on_ground, simulation.reasons
        return [
            Seen(
                simulation.time,
                tuple(place[i].tolist()),
                tuple(speed[i].tolist()),
                tuple(angles[i].tolist()),
                valid=bool(np.isfinite(place[i]).all()),
                latitude=math.degrees(latitude[i]),
                longitude=math.degrees(longitude[i]),
                altitude=float(altitude[i]),
                charge=float(charge[i]),
                on_ground=bool(standing[i]),
                stopped=reasons[i],
            )
            for i in range(len(place))
        ]

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> bool:
        """Fly for some time, or until something holds; return whether it did."""
        for _ in range(round(seconds / self.simulation.world.time_step)):
            for stack, seen in zip(self.stacks, self.see(), strict=True):
                order = stack.tick(seen)
                if order is not None:
                    self.latches.put(self.latches.checked(order))
                self.said += [text.text for text in stack.texts()]
                self.reached += [event.number for event in stack.events() if event.kind == "item_reached"]
            self.simulation.advance(self.latches.actions())
            if until is not None and until():
                return True
        return until is None

    def do(self, number: int, id: int, *params: float, frame: int = 0) -> int:
        """Give a vehicle a command and return the result."""
        numbers = [*map(float, params), *[NAN] * (7 - len(params))]
        return int(self.stacks[number].command(Command(id, tuple(numbers), frame)).result)

    def place(self, north: float, east: float) -> tuple[float, float]:
        """Latitude and longitude [deg]."""
        latitude, longitude, _ = self.simulation.site.ned_to_geodetic([north, east, 0.0])
        return math.degrees(latitude), math.degrees(longitude)

    def item(self, seq: int, command: int, *at: float, frame: int = 6, params: tuple = (0.0, 0.0, NAN, NAN)) -> Item:
        """Return an item at north, east, up [m]."""
        up = at[2] if len(at) == 3 else NAN
        x, y = (round(1e7 * angle) for angle in self.place(*at[:2])) if at else (0, 0)
        return Item(seq, frame, command, tuple(map(float, params)), x, y, up)

    @property
    def height(self) -> float:
        """Height of the site above mean sea level [m]."""
        site = self.simulation.site
        return site.height - undulation(math.degrees(site.latitude_rad), math.degrees(site.longitude_rad))

    @property
    def standing(self) -> np.ndarray:
        return self.simulation.truth.on_ground


def test_take_off_goto_mission_return_and_landing_while_the_others_stand():
    field = Field()
    simulation, stack = field.simulation, field.stacks[0]
    start = simulation.truth.position_ned
    height = field.height
    assert field.do(0, 400, 1) == 0
    assert field.do(0, 22, NAN, NAN, NAN, NAN, NAN, NAN, height + 8.0) == 0
    assert field.run(15.0, lambda: stack.mode is Mode.HOLD)
    # By what it knows of its place, to a metre of a take-off to 8 m.
    assert field.do(0, 192, -1, 1, 0, NAN, *field.place(25.0, 10.0), height + 12.0) == 0
    field.run(12.0)
    # GNSS errs by metres.
    assert simulation.truth.position_ned[0] == pytest.approx((25.0, 10.0, -12.0), abs=4.0)
    items = [
        field.item(0, 16, 30.0, -10.0, 12.0),
        field.item(1, 178, frame=2, params=(1, 7.0, -1, NAN)),
        field.item(2, 16, 0.0, -10.0, 10.0, params=(1.0, 1.0, NAN, 45.0)),
        field.item(3, 93, frame=2, params=(2.0, NAN, NAN, NAN)),
        field.item(4, 16, 10.0, 10.0, 10.0),
    ]
    assert stack.accept(PlanKind.MISSION, items) == (PlanResult.ACCEPTED, -1)
    assert field.do(0, 300) == 0
    assert field.run(60.0, lambda: stack.mission().state is MissionState.COMPLETE)
    assert field.reached == [0, 1, 2, 3, 4]
    stack.parameters.set("RTL_RETURN_ALT", 15.0)
    assert field.do(0, 20) == 0
    assert field.run(60.0, lambda: not stack.armed)
    assert field.said[-2:] == ["Landing detected", "Disarmed by landing"]
    assert field.standing.all()
    assert simulation.truth.position_ned[0] == pytest.approx(start[0], abs=4.0)
    # The others never moved.
    assert np.abs(simulation.truth.position_ned[1:] - start[1:]).max() < 0.02
    assert simulation.valid.all()


def test_five_missions_at_once_end_on_the_ground():
    field = Field(seed=5)
    for number, stack in enumerate(field.stacks):
        items = [
            field.item(0, 22, params=(NAN,) * 4),
            field.item(1, 16, 30.0, 4.0 * number, 8.0),
            field.item(2, 16, 30.0, 4.0 * number + 20.0, 10.0),
            field.item(3, 21, 0.0, 4.0 * number + 20.0, params=(NAN,) * 4),
        ]
        assert stack.accept(PlanKind.MISSION, items) == (PlanResult.ACCEPTED, -1)
        assert field.do(number, 300) == 0
    assert field.run(90.0, lambda: not any(stack.armed for stack in field.stacks)), field.said
    assert field.simulation.valid.all(), field.simulation.reasons
    assert all(stack.mission().state is MissionState.COMPLETE for stack in field.stacks)
    assert field.standing.all()


def test_attitudes_orbits_follow_me_and_sticks_at_once():
    """Vehicle 0 flies MAVSDK's example of attitudes, 1 an orbit, 2 follows, 3 and 4 are flown by sticks."""
    field = Field()
    simulation, stacks, site = field.simulation, field.stacks, field.height
    for number in range(1, 5):
        assert field.do(number, 400, 1) == 0
        assert field.do(number, 22, *[NAN] * 6, site + 8.0 + 2.0 * number) == 0
    field.run(12.0)
    sticks = {3: [0.0, 1.0, 0.0, 0.0], 4: [0.0, 0.5, 0.0, 0.0]}
    begun = simulation.time

    def fly(seconds: float, thrust: float = 0.0, roll: float = 0.0) -> None:
        for tick in range(round(seconds / 0.02)):
            half = 0.5 * math.radians(roll)
            q = (math.cos(half), math.sin(half), 0.0, 0.0)
            stacks[0].setpoint(AttitudeTarget(0x07, q, (0.0, 0.0, 0.0), thrust))
            if tick % 5 == 0:
                for number, values in sticks.items():
                    stacks[number].sticks(*values)
                place = field.place(3.0 * (simulation.time - begun), 50.0)
                stacks[2].follow_target(FollowTarget(*place, site, (3.0, 0.0, 0.0)))
            field.run(0.02)

    assert field.do(0, 400, 1) == 0
    fly(0.1)
    for number, custom in ((0, 0x00060000), (2, 0x08040000), (3, 0x00030000), (4, 0x00020000)):
        assert stacks[number].set_mode(1, custom) == 0
    assert field.do(1, 34, 15.0, 4.0, 0, NAN, *field.place(30.0, 20.0), site + 15.0) == 0
    # 70 % take off, 60 % carry the vehicle through leans of 30 degrees; that of hover is 50 %.
    for thrust, roll in ((0.7, 0.0), (0.6, 30.0), (0.6, -30.0), (0.6, 0.0)):
        fly(2.0, thrust, roll)
    truth = simulation.truth
    assert simulation.valid.all(), simulation.reasons
    assert -truth.position_ned[0, 2] > 20.0
    # MPC_VEL_MANUAL is 10 m/s, its controller flies 8; ALTITUDE keeps the height, and 15 degrees of tilt.
    assert truth.velocity_ned[3, 0] == pytest.approx(8.0, abs=1.0)
    assert truth.position_ned[4, 2] == pytest.approx(-16.0, abs=1.0)
    assert np.degrees(truth.attitude[4, 1]) == pytest.approx(-35.0 * (0.4 * 4 / 9 + 0.6 * (4 / 9) ** 3), abs=2.0)
    stacks[0].set_mode(1, 0x03040000)
    sticks[3] = [0.0, 0.0, 0.0, 0.0]
    sticks[4] = [0.0, 0.0, -1.0, 0.0]
    fly(17.0)
    truth = simulation.truth
    away = math.hypot(truth.position_ned[1, 0] - 30.0, truth.position_ned[1, 1] - 20.0)
    # GNSS errs by metres.
    assert away == pytest.approx(15.0, abs=4.0)
    assert np.linalg.norm(truth.velocity_ned[1]) == pytest.approx(4.0, abs=1.0)
    assert truth.velocity_ned[2] == pytest.approx((3.0, 0.0, 0.0), abs=0.7)
    behind = truth.position_ned[2, 0] - 3.0 * (simulation.time - begun), truth.position_ned[2, 1] - 50.0
    assert (*behind, truth.position_ned[2, 2]) == pytest.approx((-8.0, 0.0, -8.0), abs=4.0)
    assert np.linalg.norm(truth.velocity_ned[3]) < 0.5
    assert field.standing[4]
    assert not stacks[4].armed
    assert simulation.valid.all(), simulation.reasons


def test_parked_vehicles_fly_twice_and_a_kill_ends_a_flight(tmp_path):
    file = tmp_path / "parked.yaml"
    file.write_text(PARKED)
    field = Field(str(file))
    stack, simulation = field.stacks[0], field.simulation
    for _ in range(2):
        assert field.do(0, 400, 1) == 0
        assert field.do(0, 22, *[NAN] * 6, field.height + 6.0) == 0
        assert field.run(15.0, lambda: stack.mode is Mode.HOLD)
        assert not field.standing[0]
        assert field.do(0, 400, 0) == 1
        assert field.do(0, 21) == 0
        assert field.run(40.0, lambda: not stack.armed)
        assert field.standing[0]
    assert simulation.valid.all()
    assert field.do(0, 400, 1) == 0
    assert field.do(0, 22, *[NAN] * 6, field.height + 10.0) == 0
    assert field.run(15.0, lambda: stack.mode is Mode.HOLD)
    assert field.do(0, 400, 0, 21196) == 0
    assert field.run(6.0, lambda: not simulation.valid[0])
    assert simulation.reasons[0].startswith("hit_ground: speed")
    field.run(0.1)
    assert field.do(0, 400, 1, 21196) == 1
    # It is the other one's turn.
    assert field.do(1, 400, 1) == 0
