"""ArduPilot's parameters of a simulator, SIM_...: those that have an effect here, with their names, units and defaults.

Source: ArduPilot, libraries/SITL: SITL.cpp, SIM_GPS.cpp, SITL_Baro.cpp, SITL_Airspeed.cpp; as floats, which clients set
all of ArduPilot's parameters as.
"""

from __future__ import annotations

from qrsim.links.mavlink.stack.parameters import REAL32, Parameter

AXES = ("X", "Y", "Z")
FARTHEST, FASTEST = 1e5, 1e3


def _sim(name: str, default: float, low: float, high: float, unit: str, doc: str) -> Parameter:
    """Return the definition of a float parameter named SIM_NAME: default, lowest and highest value, unit,
    description."""
    return Parameter(f"SIM_{name}", REAL32, default, low, high, unit, doc)


def _axes(name: str, most: tuple[float, float, float], units: tuple[str, str, str], doc: str) -> tuple[Parameter, ...]:
    """Return the definitions of the parameters SIM_NAME_X, _Y and _Z, each from ``-most`` to ``most`` of its axis."""
    return tuple(
        _sim(f"{name}_{axis}", 0.0, -limit, limit, unit, f"{axis.lower()}: {doc}")
        for axis, limit, unit in zip(AXES, most, units, strict=True)
    )


def _alike(name: str, most: float, unit: str, doc: str) -> tuple[Parameter, ...]:
    """Return the definitions of the parameters SIM_NAME_X, _Y and _Z, all from ``-most`` to ``most``."""
    return _axes(name, (most, most, most), (unit, unit, unit), doc)


def _glitch(name: str, doc: str) -> tuple[Parameter, ...]:
    """Return the definitions of the three parameters of a position offset: latitude, longitude [deg] and height [m]."""
    return _axes(name, (180.0, 360.0, FARTHEST), ("deg", "deg", "m"), doc)


# In the order of their names.
SIM_TABLE: tuple[Parameter, ...] = (
    *_alike("ACC1_BIAS", FASTEST, "m/s^2", "what is added to the accelerometer"),
    _sim(
        "ACCEL1_FAIL", 0.0, -FASTEST, FASTEST, "m/s^2", "what all axes of the accelerometer read; 0: what they measure"
    ),
    _sim("ARSPD_FAIL", 0.0, 0.0, FASTEST, "m/s", "airspeed that the sensor is stuck at; 0: what it measures"),
    _sim("BARO_DELAY", 0.0, 0.0, 60000.0, "ms", "how late the barometer reports"),
    _sim("BARO_DISABLE", 0.0, 0.0, 1.0, "", "1: the barometer is off"),
    _sim("BARO_DRIFT", 0.0, -FASTEST, FASTEST, "m/s", "how fast the height of the barometer drifts"),
    _sim("BARO_FREEZE", 0.0, 0.0, 1.0, "", "1: the barometer repeats its last reading"),
    _sim("BARO_GLITCH", 0.0, -FARTHEST, FARTHEST, "m", "what is added to the height of the barometer"),
    _sim("BARO_RND", 0.0, 0.0, FARTHEST, "m", "more white noise of the barometer; ArduPilot's default is 0.2"),
    _sim(
        "BATT_VOLTAGE", 12.6, 0.0, 1000.0, "V", "resting voltage that the battery drops to; at boot that of a full one"
    ),
    _sim("ENGINE_FAIL", 0.0, 0.0, 65535.0, "", "mask of motors that SIM_ENGINE_MUL is applied to; bit 0: motor 1"),
    _sim("ENGINE_MUL", 0.0, 0.0, 1.0, "1", "part of its speed that such a motor reaches"),
    _sim("GPS1_ENABLE", 1.0, 0.0, 1.0, "", "0: the receiver is off"),
    *_glitch("GPS1_GLTCH", "what is added to latitude, longitude, altitude"),
    *_alike("GPS1_GLTV", FASTEST, "m/s", "velocity NED with which the reported position drifts"),
    _sim("GPS1_JAM", 0.0, 0.0, 1.0, "", "1: positions are drawn within 200 m of the origin of the site"),
    _sim("GPS1_NUMSATS", 10.0, 0.0, 255.0, "", "below 4: no fix; else without an effect"),
    _sim("GPS_DISABLE", 0.0, 0.0, 1.0, "", "1: the receiver is off; older name"),
    *_glitch("GPS_GLITCH", "as SIM_GPS1_GLTCH; older name"),
    *_alike("GYR1_BIAS", FASTEST, "rad/s", "what is added to the gyroscope"),
    _sim("MAG1_FAIL", 0.0, 0.0, 2.0, "", "1: the magnetometer is off; 2: it repeats its last reading"),
    *_alike("MAG1_OFS", FARTHEST, "mgauss", "what is subtracted from the magnetometer"),
    _sim("SHOVE_TIME", 0.0, 0.0, 1e6, "ms", "starts a shove of this duration; 0 again at its end"),
    *_alike("SHOVE", FASTEST, "m/s^2", "acceleration of the next shove, in body axes"),
    _sim("SONAR_GLITCH", 0.0, 0.0, 1.0, "1", "part of the ranges that are lost"),
    _sim("SONAR_OFFSET", 0.0, -FARTHEST, FARTHEST, "m", "what is added to the range"),
    _sim(
        "WIND_DIR",
        180.0,
        -360.0,
        360.0,
        "deg",
        "bearing that the mean wind of all vehicles comes from; at boot the scenario's",
    ),
    _sim(
        "WIND_SPD",
        0.0,
        0.0,
        FASTEST,
        "m/s",
        "mean wind of all vehicles, 20 ft above the ground; at boot the scenario's",
    ),
    _sim("WIND_TC", 5.0, 0.0, 1e4, "s", "the wind follows a change with a time constant of this / 2 pi"),
)
