"""Messages of MAVLink that are spoken here: names, numbers and layouts.

The names, types and order of fields are those of the protocol's "common" message set
(mavlink.io/en/messages/common.html), of EKF_STATUS_REPORT those of "ardupilotmega". Layouts and the byte CRC_EXTRA
follow from them by the rules of the protocol (mavlink.io/en/guide/serialization.html).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from qrsim.links.mavlink.checksum import x25

# One message each: name, number, fields with the types of ``struct`` ("c" is text); after | are extensions, which are
# sent last and do not count for CRC_EXTRA.
_TABLE = """
HEARTBEAT 0 type:B autopilot:B base_mode:B custom_mode:I system_status:B mavlink_version:B
SYS_STATUS 1 onboard_control_sensors_present:I onboard_control_sensors_enabled:I onboard_control_sensors_health:I
  load:H voltage_battery:H current_battery:h battery_remaining:b drop_rate_comm:H errors_comm:H errors_count1:H
  errors_count2:H errors_count3:H errors_count4:H | onboard_control_sensors_present_extended:I
  onboard_control_sensors_enabled_extended:I onboard_control_sensors_health_extended:I
SYSTEM_TIME 2 time_unix_usec:Q time_boot_ms:I
PING 4 time_usec:Q seq:I target_system:B target_component:B
SET_MODE 11 target_system:B base_mode:B custom_mode:I
PARAM_REQUEST_READ 20 target_system:B target_component:B param_id:16c param_index:h
PARAM_REQUEST_LIST 21 target_system:B target_component:B
PARAM_VALUE 22 param_id:16c param_value:f param_type:B param_count:H param_index:H
PARAM_SET 23 target_system:B target_component:B param_id:16c param_value:f param_type:B
GPS_RAW_INT 24 time_usec:Q fix_type:B lat:i lon:i alt:i eph:H epv:H vel:H cog:H satellites_visible:B |
  alt_ellipsoid:i h_acc:I v_acc:I vel_acc:I hdg_acc:I yaw:H
SCALED_IMU 26 time_boot_ms:I xacc:h yacc:h zacc:h xgyro:h ygyro:h zgyro:h xmag:h ymag:h zmag:h | temperature:h
RAW_IMU 27 time_usec:Q xacc:h yacc:h zacc:h xgyro:h ygyro:h zgyro:h xmag:h ymag:h zmag:h | id:B temperature:h
SCALED_PRESSURE 29 time_boot_ms:I press_abs:f press_diff:f temperature:h | temperature_press_diff:h
ATTITUDE 30 time_boot_ms:I roll:f pitch:f yaw:f rollspeed:f pitchspeed:f yawspeed:f
ATTITUDE_QUATERNION 31 time_boot_ms:I q1:f q2:f q3:f q4:f rollspeed:f pitchspeed:f yawspeed:f | repr_offset_q:4f
LOCAL_POSITION_NED 32 time_boot_ms:I x:f y:f z:f vx:f vy:f vz:f
GLOBAL_POSITION_INT 33 time_boot_ms:I lat:i lon:i alt:i relative_alt:i vx:h vy:h vz:h hdg:H
MISSION_REQUEST_PARTIAL_LIST 37 target_system:B target_component:B start_index:h end_index:h | mission_type:B
MISSION_WRITE_PARTIAL_LIST 38 target_system:B target_component:B start_index:h end_index:h | mission_type:B
MISSION_ITEM 39 target_system:B target_component:B seq:H frame:B command:H current:B autocontinue:B param1:f
  param2:f param3:f param4:f x:f y:f z:f | mission_type:B
MISSION_REQUEST 40 target_system:B target_component:B seq:H | mission_type:B
MISSION_SET_CURRENT 41 target_system:B target_component:B seq:H
MISSION_CURRENT 42 seq:H | total:H mission_state:B mission_mode:B
MISSION_REQUEST_LIST 43 target_system:B target_component:B | mission_type:B
MISSION_COUNT 44 target_system:B target_component:B count:H | mission_type:B
MISSION_CLEAR_ALL 45 target_system:B target_component:B | mission_type:B
MISSION_ITEM_REACHED 46 seq:H
MISSION_ACK 47 target_system:B target_component:B type:B | mission_type:B
GPS_GLOBAL_ORIGIN 49 latitude:i longitude:i altitude:i | time_usec:Q
MISSION_REQUEST_INT 51 target_system:B target_component:B seq:H | mission_type:B
REQUEST_DATA_STREAM 66 target_system:B target_component:B req_stream_id:B req_message_rate:H start_stop:B
MANUAL_CONTROL 69 target:B x:h y:h z:h r:h buttons:H | buttons2:H enabled_extensions:B s:h t:h aux1:h aux2:h aux3:h
  aux4:h aux5:h aux6:h
RC_CHANNELS_OVERRIDE 70 target_system:B target_component:B chan1_raw:H chan2_raw:H chan3_raw:H chan4_raw:H
  chan5_raw:H chan6_raw:H chan7_raw:H chan8_raw:H | chan9_raw:H chan10_raw:H chan11_raw:H chan12_raw:H chan13_raw:H
  chan14_raw:H chan15_raw:H chan16_raw:H chan17_raw:H chan18_raw:H
MISSION_ITEM_INT 73 target_system:B target_component:B seq:H frame:B command:H current:B autocontinue:B param1:f
  param2:f param3:f param4:f x:i y:i z:f | mission_type:B
VFR_HUD 74 airspeed:f groundspeed:f heading:h throttle:H alt:f climb:f
COMMAND_INT 75 target_system:B target_component:B frame:B command:H current:B autocontinue:B param1:f param2:f
  param3:f param4:f x:i y:i z:f
COMMAND_LONG 76 target_system:B target_component:B command:H confirmation:B param1:f param2:f param3:f param4:f
  param5:f param6:f param7:f
COMMAND_ACK 77 command:H result:B | progress:B result_param2:i target_system:B target_component:B
SET_ATTITUDE_TARGET 82 time_boot_ms:I target_system:B target_component:B type_mask:B q:4f body_roll_rate:f
  body_pitch_rate:f body_yaw_rate:f thrust:f
ATTITUDE_TARGET 83 time_boot_ms:I type_mask:B q:4f body_roll_rate:f body_pitch_rate:f body_yaw_rate:f thrust:f
SET_POSITION_TARGET_LOCAL_NED 84 time_boot_ms:I target_system:B target_component:B coordinate_frame:B type_mask:H
  x:f y:f z:f vx:f vy:f vz:f afx:f afy:f afz:f yaw:f yaw_rate:f
POSITION_TARGET_LOCAL_NED 85 time_boot_ms:I coordinate_frame:B type_mask:H x:f y:f z:f vx:f vy:f vz:f afx:f afy:f
  afz:f yaw:f yaw_rate:f
SET_POSITION_TARGET_GLOBAL_INT 86 time_boot_ms:I target_system:B target_component:B coordinate_frame:B type_mask:H
  lat_int:i lon_int:i alt:f vx:f vy:f vz:f afx:f afy:f afz:f yaw:f yaw_rate:f
POSITION_TARGET_GLOBAL_INT 87 time_boot_ms:I coordinate_frame:B type_mask:H lat_int:i lon_int:i alt:f vx:f vy:f vz:f
  afx:f afy:f afz:f yaw:f yaw_rate:f
HIL_ACTUATOR_CONTROLS 93 time_usec:Q controls:16f mode:B flags:Q
HIGHRES_IMU 105 time_usec:Q xacc:f yacc:f zacc:f xgyro:f ygyro:f zgyro:f xmag:f ymag:f zmag:f abs_pressure:f
  diff_pressure:f pressure_alt:f temperature:f fields_updated:H | id:B
OPTICAL_FLOW_RAD 106 time_usec:Q sensor_id:B integration_time_us:I integrated_x:f integrated_y:f integrated_xgyro:f
  integrated_ygyro:f integrated_zgyro:f temperature:h quality:B time_delta_distance_us:I distance:f
HIL_SENSOR 107 time_usec:Q xacc:f yacc:f zacc:f xgyro:f ygyro:f zgyro:f xmag:f ymag:f zmag:f abs_pressure:f
  diff_pressure:f pressure_alt:f temperature:f fields_updated:I | id:B
FILE_TRANSFER_PROTOCOL 110 target_network:B target_system:B target_component:B payload:251B
TIMESYNC 111 tc1:q ts1:q
HIL_GPS 113 time_usec:Q fix_type:B lat:i lon:i alt:i eph:H epv:H vel:H vn:h ve:h vd:h cog:H satellites_visible:B |
  id:B yaw:H
HIL_OPTICAL_FLOW 114 time_usec:Q sensor_id:B integration_time_us:I integrated_x:f integrated_y:f integrated_xgyro:f
  integrated_ygyro:f integrated_zgyro:f temperature:h quality:B time_delta_distance_us:I distance:f
HIL_STATE_QUATERNION 115 time_usec:Q attitude_quaternion:4f rollspeed:f pitchspeed:f yawspeed:f lat:i lon:i alt:i
  vx:h vy:h vz:h ind_airspeed:H true_airspeed:H xacc:h yacc:h zacc:h
LOG_REQUEST_LIST 117 target_system:B target_component:B start:H end:H
LOG_ENTRY 118 id:H num_logs:H last_log_num:H time_utc:I size:I
DISTANCE_SENSOR 132 time_boot_ms:I min_distance:H max_distance:H current_distance:H type:B id:B orientation:B
  covariance:B | horizontal_fov:f vertical_fov:f quaternion:4f signal_quality:B
SET_ACTUATOR_CONTROL_TARGET 139 time_usec:Q group_mlx:B target_system:B target_component:B controls:8f
ALTITUDE 141 time_usec:Q altitude_monotonic:f altitude_amsl:f altitude_local:f altitude_relative:f
  altitude_terrain:f bottom_clearance:f
FOLLOW_TARGET 144 timestamp:Q est_capabilities:B lat:i lon:i alt:f vel:3f acc:3f attitude_q:4f rates:3f
  position_cov:3f custom_state:Q
BATTERY_STATUS 147 id:B battery_function:B type:B temperature:h voltages:10H current_battery:h current_consumed:i
  energy_consumed:i battery_remaining:b | time_remaining:i charge_state:B voltages_ext:4H mode:B fault_bitmask:I
AUTOPILOT_VERSION 148 capabilities:Q flight_sw_version:I middleware_sw_version:I os_sw_version:I board_version:I
  flight_custom_version:8B middleware_custom_version:8B os_custom_version:8B vendor_id:H product_id:H uid:Q |
  uid2:18B
ESTIMATOR_STATUS 230 time_usec:Q flags:H vel_ratio:f pos_horiz_ratio:f pos_vert_ratio:f mag_ratio:f hagl_ratio:f
  tas_ratio:f pos_horiz_accuracy:f pos_vert_accuracy:f
WIND_COV 231 time_usec:Q wind_x:f wind_y:f wind_z:f var_horiz:f var_vert:f wind_alt:f horiz_accuracy:f
  vert_accuracy:f
EKF_STATUS_REPORT 193 flags:H velocity_variance:f pos_horiz_variance:f pos_vert_variance:f compass_variance:f
  terrain_alt_variance:f | airspeed_variance:f
HOME_POSITION 242 latitude:i longitude:i altitude:i x:f y:f z:f q:4f approach_x:f approach_y:f approach_z:f |
  time_usec:Q
MESSAGE_INTERVAL 244 message_id:H interval_us:i
EXTENDED_SYS_STATE 245 vtol_state:B landed_state:B
ADSB_VEHICLE 246 ICAO_address:I lat:i lon:i altitude_type:B altitude:i heading:H hor_velocity:H ver_velocity:h
  callsign:9c emitter_type:B tslc:B flags:H squawk:H
STATUSTEXT 253 severity:B text:50c | id:H chunk_seq:B
PROTOCOL_VERSION 300 version:H min_version:H max_version:H spec_version_hash:8B library_version_hash:8B
OBSTACLE_DISTANCE 330 time_usec:Q sensor_type:B distances:72H increment:B min_distance:H max_distance:H |
  increment_f:f angle_offset:f frame:B
ODOMETRY 331 time_usec:Q frame_id:B child_frame_id:B x:f y:f z:f q:4f vx:f vy:f vz:f rollspeed:f pitchspeed:f
  yawspeed:f pose_covariance:21f velocity_covariance:21f | reset_counter:B estimator_type:B quality:b
AVAILABLE_MODES 435 number_modes:B mode_index:B standard_mode:B custom_mode:I properties:I mode_name:35c
CURRENT_MODE 436 standard_mode:B custom_mode:I intended_custom_mode:I
AVAILABLE_MODES_MONITOR 437 seq:B
PARAM_ERROR 345 target_system:B target_component:B param_id:16c param_index:h error:B
ORBIT_EXECUTION_STATUS 360 time_usec:Q radius:f frame:B x:i y:i z:f
FENCE_STATUS 162 breach_status:B breach_count:H breach_type:B breach_time:I | breach_mitigation:B
"""
_SIZES = {"c": 1, "B": 1, "b": 1, "H": 2, "h": 2, "I": 4, "i": 4, "f": 4, "Q": 8, "q": 8}
_TYPES = {
    "c": "char",
    "B": "uint8_t",
    "b": "int8_t",
    "H": "uint16_t",
    "h": "int16_t",
    "I": "uint32_t",
    "i": "int32_t",
    "Q": "uint64_t",
    "q": "int64_t",
    "f": "float",
}


@dataclass(frozen=True)
class Field:
    """A field of a message: its name, type, and how many of them there are (0: one, and no array)."""

    name: str
    type: str
    count: int

    @staticmethod
    def of(text: str) -> Field:
        """Parse a message field written as "name:type" or, for an array of four floats, "name:4f"."""
        name, _, kind = text.partition(":")
        return Field(name, kind[-1], int(kind[:-1] or 0))

    @property
    def format(self) -> str:
        """Return the ``struct`` format of this field, such as "4f" for an array of four floats."""
        if self.type == "c":
            return f"{self.count}s"
        return f"{self.count or ''}{self.type}"


class Message:
    """A message as it arrived: its fields are attributes; arrays are tuples, texts are bytes without trailing zeros."""

    def __init__(self, layout: Layout, values: Mapping[str, object]):
        self.layout = layout
        self.__dict__.update(values)

    def __getattr__(self, field: str) -> Any:
        raise AttributeError(f"{self.layout.name} has no field '{field}'")

    def __repr__(self) -> str:
        values = {name: value for name, value in vars(self).items() if name != "layout"}
        return f"<{self.layout.name} {values}>"


@dataclass(frozen=True)
class Layout:
    """How a message lies on the wire.

    Attributes:
        name: of the message.
        number: its id.
        fields: as they are sent: by size, the largest first, then the extensions.
        own: how many of them are no extensions.
    """

    name: str
    number: int
    fields: tuple[Field, ...]
    own: int

    @staticmethod
    def of(line: str) -> Layout:
        """Parse a line of the message table ("name number field field ... | extension fields") to a Layout."""
        head, _, extensions = line.partition("|")
        name, number, *fields = head.split()
        own = sorted(map(Field.of, fields), key=lambda field: -_SIZES[field.type])
        return Layout(name, int(number), (*own, *map(Field.of, extensions.split())), len(own))

    @cached_property
    def struct(self) -> struct.Struct:
        """Return the ``struct.Struct`` that packs all fields of the message in wire order, arrays element by
        element."""
        return struct.Struct("<" + "".join(field.format for field in self.fields))

    @cached_property
    def least(self) -> int:
        """Return the size [bytes] of the payload without extension fields, as in MAVLink 1."""
        return struct.calcsize("<" + "".join(field.format for field in self.fields[: self.own]))

    @cached_property
    def extra(self) -> int:
        """Return CRC_EXTRA, the byte that makes checksums fail where two programs define the message differently."""
        text = f"{self.name} ".encode()
        for field in self.fields[: self.own]:
            text += f"{_TYPES[field.type]} {field.name} ".encode()
            if field.count:
                text += bytes([field.count])
        check = x25(text)
        return (check & 0xFF) ^ (check >> 8)

    def payload(self, **values: Any) -> bytes:
        """Encode the message's payload from field values by name; omitted fields are 0.

        Raises:
            ValueError: there is no such field, or an array has another length.
            struct.error: a number is out of its range.
        """
        numbers: list[object] = []
        for field in self.fields:
            value = values.pop(field.name, None)
            if field.type == "c":
                numbers.append(b"" if value is None else value)
            elif not field.count:
                numbers.append(0 if value is None else value)
            else:
                numbers += [0] * field.count if value is None else value
        if values:
            raise ValueError(f"{self.name} has no field {', '.join(values)}")
        return self.struct.pack(*numbers)

    def message(self, payload: bytes) -> Message:
        """Decode a payload to a message with attributes by field name; missing bytes at its end count as 0, surplus
        ones are ignored."""
        size = self.struct.size
        numbers = self.struct.unpack(payload[:size].ljust(size, b"\0"))
        values: dict[str, object] = {}
        at = 0
        for field in self.fields:
            if field.type == "c":
                values[field.name] = numbers[at].partition(b"\0")[0]
                at += 1
            elif field.count:
                values[field.name] = numbers[at : at + field.count]
                at += field.count
            else:
                values[field.name] = numbers[at]
                at += 1
        return Message(self, values)


def _layouts() -> dict[str, Layout]:
    """Parse the table of messages above; return message name -> Layout."""
    lines: list[str] = []
    for line in _TABLE.strip().splitlines():
        if line.startswith(" "):
            lines[-1] += line
        else:
            lines.append(line)
    found = [Layout.of(line) for line in lines]
    return {layout.name: layout for layout in found}


LAYOUTS = _layouts()
BY_NUMBER = {layout.number: layout for layout in LAYOUTS.values()}
NUMBERS = {layout.name: layout.number for layout in LAYOUTS.values()}
