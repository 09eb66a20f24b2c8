"""The sensor ``imu``: gyroscope and accelerometer of one chip, with the errors of IEEE Std 952.

See docs/howto/sensors_inertial.md.

    y = sat_q( LP( (I + E)(x + vibration) + G a + b + n ) )

E has scale on its diagonal and misalignment beside it, G is the gyroscope's sensitivity to acceleration, LP the chip's
low-pass. The bias b is the turn-on bias, a random walk from there, and bias instability: Gauss-Markov processes whose
correlation times are a decade apart and whose variances are equal, which together are flicker noise between them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import reduce
from operator import add
from typing import Any, ClassVar, Literal, cast

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Noise
from qrsim.core.presets import Presets
from qrsim.core.tree import computed, parameter, quantity, record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.sensors.imu_presets import PRESETS, default
from qrsim.models.sensors.quantization import quantized
from qrsim.models.sensors.vibration import Vibration, measured
from qrsim.models.vehicles.contracts import Load

# Correlation times [s] of bias instability, and std of each process per B, by which flicker noise has B^2 / (2 pi f):
# a process of each decade of times with variance s^2 is s^2 / (ln 10 f) one-sided.
TIMES = (5.0, 50.0, 500.0)
SHARE = math.sqrt(math.log(10.0) / math.pi)
# The slow errors of one of the six axes move on at each reading, by six periods, because they hardly change in one.
AXES = 6
# Specific force of a level vehicle at rest along its z axis [m/s^2].
AT_REST = -9.81
_SLOW = len(TIMES) + 1
# Normals of a start: turn-on bias, E of both, G, bias instability, the phase of vibration.
_MATRIX = 9
_START = AXES + 3 * _MATRIX + AXES * len(TIMES) + 1

Six = tuple[Array, ...]


def _number(name: str, unit: str, doc: str) -> Array:
    """Return the field declaration of a parameter, at least 0, with the default preset's value as default."""
    return parameter(default=default(name), unit=unit, doc=doc, minimum=0.0)


def _structure(name: str, unit: str, doc: str) -> float:
    """Return the field declaration of a setting, at least 0, with the default preset's value as default."""
    return setting(default=default(name), unit=unit, doc=doc, minimum=0.0)


@record
class ImuReading:
    """Means over the time since the last reading, and their integrals over it."""

    rates_body: Vec3 = quantity(unit="rad/s", doc="measured body rates (p, q, r), mean since the last reading")
    specific_force: Vec3 = quantity(
        unit="m/s^2", doc="measured specific force in body axes, mean since the last reading; -g along z at rest"
    )
    delta_angle: Vec3 = quantity(unit="rad", doc="rotation vector since the last reading, with coning correction")
    delta_velocity: Vec3 = quantity(unit="m/s", doc="integral of the specific force since the last reading")


@record
class ImuState:
    """State of n chips. Axes are numbered gyroscope x, y, z, accelerometer x, y, z."""

    gyroscope_error: tuple[Vec3, Vec3, Vec3] = quantity(unit="1", doc="rows of E of the gyroscope")
    accelerometer_error: tuple[Vec3, Vec3, Vec3] = quantity(unit="1", doc="rows of E of the accelerometer")
    g_sensitivity: tuple[Vec3, Vec3, Vec3] = quantity(unit="s/m", doc="rows of G")
    wandering: tuple[Six, ...] = quantity(unit="1", doc="bias instability of each axis, of variance 1 each")
    walk: Six = quantity(unit="rad/s or m/s^2", doc="turn-on bias and random walk of each axis")
    turn: Array = quantity(unit="1", doc="axis of the slow errors that move on next")
    rates: Vec3 = quantity(unit="rad/s", doc="true rates at the last reading")
    angle: Vec3 = quantity(unit="rad", doc="last measured step of the angle")
    low_pass: Any = quantity(doc="two memories of each axis; None without a filter")
    phase: Any = quantity(unit="1", doc="phase of the rotors [turns]; None without vibration")


@record
class Imu(Sensor):
    """Gyroscope and accelerometer of one chip: noise, bias, scale, misalignment, vibration, quantisation.

    Parameters that are not given are those of the preset. What is drawn once, as the turn-on bias, is drawn for each
    vehicle and episode. A reading is the mean over its period, in which the rates are taken to change linearly.
    """

    preset: Literal["mpu6000", "icm20689", "bmi088", "icm42688p", "adis16470", "pelican"] = setting(
        default="icm42688p", doc="chip that provides the parameters left out"
    )
    gyroscope_noise: Array = _number("gyroscope_noise", "rad/s^0.5", "N, angle random walk")
    gyroscope_bias_instability: Array = _number("gyroscope_bias_instability", "rad/s", "B, flicker noise")
    gyroscope_random_walk: Array = _number("gyroscope_random_walk", "rad/s^1.5", "K, rate random walk")
    gyroscope_turn_on_bias: Array = _number("gyroscope_turn_on_bias", "rad/s", "std per episode and axis")
    gyroscope_scale: Array = _number("gyroscope_scale", "1", "std of the scale error of each axis")
    gyroscope_misalignment: Array = _number("gyroscope_misalignment", "rad", "std of each angle between axes")
    gyroscope_g_sensitivity: Array = _number("gyroscope_g_sensitivity", "rad s/m", "std of each element of G")
    accelerometer_noise: Array = _number("accelerometer_noise", "m/s^1.5", "N, velocity random walk")
    accelerometer_bias_instability: Array = _number("accelerometer_bias_instability", "m/s^2", "B, flicker noise")
    accelerometer_random_walk: Array = _number(
        "accelerometer_random_walk", "m/s^2.5", "K, random walk of the acceleration"
    )
    accelerometer_turn_on_bias: Array = _number("accelerometer_turn_on_bias", "m/s^2", "std per episode and axis")
    accelerometer_scale: Array = _number("accelerometer_scale", "1", "std of the scale error of each axis")
    accelerometer_misalignment: Array = _number("accelerometer_misalignment", "rad", "std of each angle between axes")
    vibration_levels: Vibration = quantity(default=Vibration(), doc="levels of vibration 'rotors'")
    vibration: Literal["none", "rotors", "measured"] = setting(
        default="none", doc="vibration of the airframe: from vibration_levels, or as recorded on the real vehicle"
    )
    gyroscope_range: float = _structure("gyroscope_range", "rad/s", "largest rate; 0: any")
    gyroscope_resolution: float = _structure("gyroscope_resolution", "rad/s", "step of a sample; 0: none")
    accelerometer_range: float = _structure("accelerometer_range", "m/s^2", "largest specific force; 0: any")
    accelerometer_resolution: float = _structure("accelerometer_resolution", "m/s^2", "step of a sample; 0: none")
    sample_rate: float = setting(
        default=default("sample_rate"),
        unit="Hz",
        doc="sample rate of the chip; a reading is the mean of its samples, and its steps are finer by their number",
        above=0.0,
    )
    bandwidth_hz: float = setting(
        default=0.0,
        unit="Hz",
        doc="-3 dB frequency of the chip's low-pass, a second-order Butterworth filter; 0: none",
        minimum=0.0,
    )
    subsamples: int = setting(
        default=1, unit="1", doc="parts of a period that are measured separately", minimum=1, maximum=32
    )
    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("rates_body", "specific_force", "load")
    presets: ClassVar[Presets] = PRESETS

    @computed
    def normals(self) -> int:
        """Number of standard normals that a step draws per vehicle: white noise, and slow errors of one axis."""
        return AXES * self.subsamples + _SLOW

    @computed
    def first_normals(self) -> int:
        """Number of standard normals that the start draws per vehicle."""
        return _START + AXES * self.subsamples

    @property
    def bias_scale(self) -> Six:
        """Std of each bias-instability process: three gyroscope axes [rad/s], three accelerometer axes [m/s^2]."""
        found = (self.gyroscope_bias_instability,) * 3 + (self.accelerometer_bias_instability,) * 3
        return tuple(SHARE * b for b in found)

    def bias(self, state: ImuState) -> tuple[Vec3, Vec3]:
        """Return the true present bias (n,) of gyroscope [rad/s] and accelerometer [m/s^2]."""
        found = [
            scale * reduce(add, slow) + walk
            for scale, slow, walk in zip(self.bias_scale, state.wandering, state.walk, strict=True)
        ]
        return Vec3(*found[:3]), Vec3(*found[3:])

    def biases(self, state: ImuState) -> dict[str, Vec3]:
        """Return the readings' errors for a level vehicle at rest, {field: (n,)}: bias, and errors caused by 1 g."""
        gyroscope, accelerometer = self.bias(state)
        return {
            "rates_body": gyroscope + Vec3(*(row.z * AT_REST for row in state.g_sensitivity)),
            "specific_force": accelerometer + Vec3(*(row.z * AT_REST for row in state.accelerometer_error)),
        }

    def white_noise(self) -> dict[str, Array]:
        """Return the standard deviation of a reading's white noise, {field: std}."""
        return {
            "rates_body": self.gyroscope_noise / math.sqrt(self.period),
            "specific_force": self.accelerometer_noise / math.sqrt(self.period),
        }

    def init(self, draw: Noise, rates_body: Vec3, specific_force: Vec3, load: Load) -> tuple[ImuState, ImuReading]:
        """Return state and first reading of IMUs that have just been switched on."""
        normals = draw.normals(self.first_normals)
        given = iter(normals)
        turned_on = (self.gyroscope_turn_on_bias,) * 3 + (self.accelerometer_turn_on_bias,) * 3
        zero = jnp.zeros_like(rates_body.x)
        still = Vec3(zero, zero, zero)
        walk = tuple(std * next(given) for std in turned_on)
        gyroscope = _rows(given, self.gyroscope_scale, self.gyroscope_misalignment)
        accelerometer = _rows(given, self.accelerometer_scale, self.accelerometer_misalignment)
        sensitivity = _rows(given, self.gyroscope_g_sensitivity, self.gyroscope_g_sensitivity)
        wandering = tuple(tuple(next(given) for _ in TIMES) for _ in range(AXES))
        # Many turns wide, so that the rest of a turn is as good as uniform.
        turns = 10.0 * next(given)
        state = ImuState(
            gyroscope,
            accelerometer,
            sensitivity,
            wandering,
            walk,
            zero,
            rates_body,
            still,
            None,
            turns - jnp.round(turns) if self._shakes else None,
        )
        return self._measure(state, normals[_START:], rates_body, specific_force, load, settled=True)

    def restart(
        self, state: ImuState, draw: Noise, since: Array, rates_body: Vec3, specific_force: Vec3, load: Load
    ) -> tuple[ImuState, ImuReading]:
        """Return state and reading of the same IMUs after ``set_state`` has moved their vehicles; biases are kept."""
        zero = jnp.zeros_like(rates_body.x)
        moved = replace(state, rates=rates_body, angle=Vec3(zero, zero, zero))
        normals = draw.normals(self.first_normals)[_START:]
        return self._measure(moved, normals, rates_body, specific_force, load, settled=True)

    def step(
        self, state: ImuState, draw: Noise, rates_body: Vec3, specific_force: Vec3, load: Load
    ) -> tuple[ImuState, ImuReading]:
        """Return state and reading one period later, with the biases drifted."""
        normals = draw.normals(self.normals)
        wandering, walk = self._moved_on(state, normals[AXES * self.subsamples :])
        last = state.turn > AXES - 1.5
        state = replace(state, wandering=wandering, walk=walk, turn=jnp.where(last, 0.0, state.turn + 1.0))
        return self._measure(state, normals, rates_body, specific_force, load)

    def _moved_on(self, state: ImuState, normals: tuple[Array, ...]) -> tuple[tuple[Six, ...], Six]:
        """Return bias-instability and random-walk states, with one axis (in turn) advanced by six periods."""
        span = AXES * self.period
        root = math.sqrt(span)
        steps = (self.gyroscope_random_walk,) * 3 + (self.accelerometer_random_walk,) * 3
        decays = [(math.exp(-span / time), math.sqrt(-math.expm1(-2.0 * span / time))) for time in TIMES]
        wandering, walk = [], []
        for axis in range(AXES):
            now = jnp.abs(state.turn - float(axis)) < 0.5
            wandering.append(
                tuple(
                    jnp.where(now, decay * slow + spread * normal, slow)
                    for slow, (decay, spread), normal in zip(state.wandering[axis], decays, normals, strict=False)
                )
            )
            walk.append(jnp.where(now, state.walk[axis] + root * steps[axis] * normals[_SLOW - 1], state.walk[axis]))
        return tuple(wandering), tuple(walk)

    @property
    def _shakes(self) -> bool:
        """True if vibration of the vehicle is simulated."""
        return self.vibration != "none"

    def _measure(
        self,
        state: ImuState,
        normals: tuple[Array, ...],
        rates_body: Vec3,
        specific_force: Vec3,
        load: Load,
        settled: bool = False,
    ) -> tuple[ImuState, ImuReading]:
        """Return state and reading over a period; ``settled``: the low-pass filter starts in the steady state."""
        parts = self.subsamples
        dt = self.period / parts
        levels = measured() if self.vibration == "measured" else self.vibration_levels
        thrust = load.per_weight(rates_body.x) if self._shakes else rates_body.x
        spreads = self._spreads(levels, thrust, dt)
        biases = self.bias(state)
        low_pass, phase, last = state.low_pass, state.phase, state.angle
        total = [jnp.zeros_like(rates_body.x)] * AXES
        turned = coning = Vec3.zeros(rates_body.x.shape, rates_body.x.dtype)
        for part in range(parts):
            # The mean of this part, where the rates change linearly.
            share = (part + 0.5) / parts
            rates, force = state.rates * (1.0 - share) + rates_body * share, specific_force
            if self._shakes:
                phase = levels.turned(phase, thrust, dt)
                gyroscope_waves, accelerometer_waves = levels.harmonics(phase, thrust)
                rates, force = rates + gyroscope_waves, force + accelerometer_waves
            gyroscope = rates + _times(state.gyroscope_error, rates) + _times(state.g_sensitivity, force) + biases[0]
            accelerometer = force + _times(state.accelerometer_error, force) + biases[1]
            clean = (*gyroscope.axes, *accelerometer.axes)
            noise = normals[AXES * part : AXES * (part + 1)]
            noisy = tuple(x + std * normal for x, std, normal in zip(clean, spreads, noise, strict=True))
            if self.bandwidth_hz > 0.0:
                if settled and part == 0:
                    low_pass = self._at_rest(clean)
                noisy, low_pass = self._filtered(noisy, low_pass, dt)
            noisy = self._converted(noisy, dt)
            total = [a + b for a, b in zip(total, noisy, strict=True)]
            step = Vec3(*noisy[:3]) * dt
            coning = coning + (turned + last * (1.0 / 6.0)).cross(step) * 0.5
            turned, last = turned + step, step
        mean = [axis * (1.0 / parts) for axis in total]
        reading = ImuReading(Vec3(*mean[:3]), Vec3(*mean[3:]), turned + coning, Vec3(*mean[3:]) * self.period)
        return replace(state, rates=rates_body, angle=last, low_pass=low_pass, phase=phase), reading

    def _spreads(self, levels: Vibration, thrust: Array, dt: float) -> Six:
        """Return the std of each axis' white noise over dt [s], with broadband vibration at a relative thrust (n,)."""
        rate = 1.0 / math.sqrt(dt)
        white = [rate * jnp.asarray(self.gyroscope_noise)] * 3 + [rate * jnp.asarray(self.accelerometer_noise)] * 3
        if not self._shakes:
            return tuple(white)
        shaken = [axis for vector in levels.spreads(thrust) for axis in vector.axes]
        return tuple(jnp.sqrt(a * a + b * b) for a, b in zip(white, shaken, strict=True))

    def _low_pass(self, dt: float) -> tuple[float, float, float]:
        """Return b0, a1, a2 of the second-order low-pass filter (bilinear transform), -3 dB at ``bandwidth_hz``."""
        k = math.tan(math.pi * self.bandwidth_hz * dt)
        norm = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
        return k * k * norm, 2.0 * (k * k - 1.0) * norm, (1.0 - math.sqrt(2.0) * k + k * k) * norm

    def _at_rest(self, values: Six) -> tuple[tuple[Array, Array], ...]:
        """Return the low-pass filter's steady state for six constant inputs."""
        b0, _, a2 = self._low_pass(self.period / self.subsamples)
        return tuple((x * (1.0 - b0), x * (b0 - a2)) for x in values)

    def _filtered(
        self, values: Six, memory: tuple[tuple[Array, Array], ...], dt: float
    ) -> tuple[Six, tuple[tuple[Array, Array], ...]]:
        """Return the six low-pass outputs (transposed direct form II) after dt [s], and the filter's new state."""
        b0, a1, a2 = self._low_pass(dt)
        passed, after = [], []
        for x, (first, second) in zip(values, memory, strict=True):
            y = b0 * x + first
            passed.append(y)
            after.append((2.0 * b0 * x - a1 * y + second, b0 * x - a2 * y))
        return tuple(passed), tuple(after)

    def _converted(self, values: Six, dt: float) -> Six:
        """Return six measured values (n,) clipped to the sensor's range and rounded to its resolution."""
        samples = max(1.0, self.sample_rate * dt)
        kinds = [(self.gyroscope_range, self.gyroscope_resolution)] * 3
        kinds += [(self.accelerometer_range, self.accelerometer_resolution)] * 3
        return tuple(
            quantized(value, limit, resolution / samples)
            for value, (limit, resolution) in zip(values, kinds, strict=True)
        )


@record
class IdealImu(Sensor):
    """The truth at the same period: the rates of its end, the mean specific force, and their integrals."""

    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("rates_body", "specific_force", "load")

    def init(self, draw: Noise, rates_body: Vec3, specific_force: Vec3, load: Load) -> tuple[Vec3, ImuReading]:
        """Return the true body rates as state, and the first reading without errors."""
        return self.step(rates_body, draw, rates_body, specific_force, load)

    def step(
        self, state: Vec3, draw: Noise, rates_body: Vec3, specific_force: Vec3, load: Load
    ) -> tuple[Vec3, ImuReading]:
        """Return the true body rates as state, and the true reading; its angle is that of linearly changing rates."""
        angle = (state + rates_body) * (0.5 * self.period)
        angle = angle + state.cross(rates_body) * (self.period * self.period / 12.0)
        return rates_body, ImuReading(rates_body, specific_force, angle, specific_force * self.period)


def _rows(given: Iterator[Array], diagonal: Array, off_diagonal: Array) -> tuple[Vec3, Vec3, Vec3]:
    """Return the rows of a random 3 x 3 matrix, its entries of std ``diagonal`` or ``off_diagonal``."""
    rows = [Vec3(*((diagonal if i == j else off_diagonal) * next(given) for j in range(3))) for i in range(3)]
    return cast(tuple[Vec3, Vec3, Vec3], tuple(rows))


def _times(rows: tuple[Vec3, Vec3, Vec3], vector: Vec3) -> Vec3:
    """Return the product of a 3 x 3 matrix, given by its rows, and a vector."""
    return Vec3(*(row.dot(vector) for row in rows))
