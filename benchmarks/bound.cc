// The practical limit of one step on a CPU, for bound.py: by hand, in vectors; no part of the package.
//
// The step is that of the default scenario with the full Dryden turbulence and without GNSS (the horizontal position
// and velocity are the truth at 5 Hz): route, waypoint controller fed with the sensors, log shear, gusts along and
// about all axes, Heun integration of the identified quadrotor with process noise, area and state limits, barometer,
// attitude estimator, gyroscope, accelerometer. No vehicle sees another one.
// Formulas and sources: docs/explanation/models/index.md.
//
// Arguments: run VEHICLES TICKS REPEATS THREADS   prints "wall_seconds cpu_seconds flying" of each repeat
//            check FIRST TICKS SPEED_20FT         reads stream keys and fields of 16 vehicles, prints them TICKS later
//            words KEY_HIGH KEY_LOW TICK COUNT    prints the generator's words and normals of the ids below COUNT

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <limits>
#include <string>
#include <thread>
#include <vector>

#include "vectors.h"

namespace {

// ---- elementary functions, errors below 2e-7 (polynomials of Cephes, S. L. Moshier)

struct Trig {
  F sine, cosine;
};

// |y| <= pi/4, plus quarter turns.
INLINE Trig sincos_reduced(F y, I quarter) {
  F z = y * y;
  F sine = y + y * z * horner(z, -1.9515295891e-4, 8.3321608736e-3, -1.6666654611e-1);
  F cosine = 1.0f - 0.5f * z + z * z * horner(z, 2.443315711809948e-5, -1.388731625493765e-3, 4.166664568298827e-2);
  I odd = (quarter & 1) != 0;
  return {flipped(odd ? cosine : sine, quarter >> 1), flipped(odd ? sine : cosine, (quarter + 1) >> 1)};
}

INLINE Trig sincos(F x) {
  F turns = nearest(x * 0.636619772f);
  F y = ((x - turns * 1.5703125f) - turns * 4.837512969970703125e-4f) - turns * 7.54978995489188e-8f;
  return sincos_reduced(y, __builtin_convertvector(turns, I));
}

INLINE F logarithm(F x) {
  I bits = (I)x;
  I exponent = (bits - 0x3F3504F3) >> 23;
  F f = as_float(bits - (exponent << 23)) - 1.0f, e = __builtin_convertvector(exponent, F), z = f * f;
  F tail = horner(f, 7.0376836292e-2, -1.1514610310e-1, 1.1676998740e-1, -1.2420140846e-1, 1.4249322787e-1,
                  -1.6668057665e-1, 2.0000714765e-1, -2.4999993993e-1, 3.3333331174e-1);
  return (f + ((f * z * tail + e * -2.12194440e-4f) - 0.5f * z)) + e * 0.693359375f;
}

// |x| < 87
INLINE F exponential(F x) {
  F k = nearest(x * 1.44269504f);
  F r = (x - k * 0.693359375f) - k * -2.12194440e-4f;
  F tail = horner(r, 1.9875691500e-4, 1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1,
                  5.0000001201e-1);
  return (1.0f + (r + r * r * tail)) * as_float((__builtin_convertvector(k, I) + 127) << 23);
}

// ---- random numbers: Threefry-2x32 with 13 rounds, key (high, low + index), counter (tick, id)

struct Key {
  uint32_t high, low;
};
struct Words {
  U first, second;
};
struct Normals {
  F first, second;
};

template <int N, int K>
INLINE void round_of(U* x0, U* x1) {
  for (int i = 0; i < K; i++) x0[i] += x1[i];
  for (int i = 0; i < K; i++) x1[i] = turned<N>(x1[i]);
  for (int i = 0; i < K; i++) x1[i] ^= x0[i];
}

template <int K>
INLINE void inject(U* x0, U* x1, const uint32_t (*k)[3], int first, int second, uint32_t group) {
  for (int i = 0; i < K; i++) x0[i] += k[i][first], x1[i] += k[i][second] + group;
}

// K draws side by side, because one alone is a single chain of operations.
template <int K>
INLINE void threefry(const Key* keys, uint32_t tick, U id, Words* drawn) {
  uint32_t k[K][3];
  U x0[K], x1[K];
  for (int i = 0; i < K; i++) {
    k[i][0] = keys[i].high, k[i][1] = keys[i].low, k[i][2] = k[i][0] ^ k[i][1] ^ 0x1BD11BDAu;
    x0[i] = U{} + (tick + k[i][0]), x1[i] = id + k[i][1];
  }
  round_of<13, K>(x0, x1), round_of<15, K>(x0, x1), round_of<26, K>(x0, x1), round_of<6, K>(x0, x1);
  inject<K>(x0, x1, k, 1, 2, 1);
  round_of<17, K>(x0, x1), round_of<29, K>(x0, x1), round_of<16, K>(x0, x1), round_of<24, K>(x0, x1);
  inject<K>(x0, x1, k, 2, 0, 2);
  round_of<13, K>(x0, x1), round_of<15, K>(x0, x1), round_of<26, K>(x0, x1), round_of<6, K>(x0, x1);
  inject<K>(x0, x1, k, 0, 1, 3);
  round_of<17, K>(x0, x1);
  for (int i = 0; i < K; i++) drawn[i] = {x0[i], x1[i]};
}

INLINE Normals box_muller(Words words) {
  F uniform = (__builtin_convertvector((I)(words.first >> 1), F) + 0.5f) * 4.656612873077393e-10f;
  F t = larger(-2.0f * logarithm(uniform), all(1e-30f)), radius = t * inverse_root(t);
  // The upper bits of the angle are quarter turns, without a reduction.
  I quarter = ((I)words.second + 0x20000000) >> 30;
  F angle = __builtin_convertvector((I)words.second - (I)((U)quarter << 30), F) * 1.462918079267160e-9f;
  Trig trig = sincos_reduced(angle, quarter);
  return {radius * trig.cosine, radius * trig.sine};
}

// ---- what one vehicle remembers; w0 to w15 are four waypoints (north, east, down, yaw)

#define FIELDS(X)                                                                                                   \
  X(north) X(east) X(down) X(roll) X(pitch) X(yaw) X(u) X(v) X(w) X(p) X(q) X(r) X(thrust)                          \
  X(along) X(across1) X(across2) X(across3) X(down1) X(down2) X(down3) X(roll_gust)                                 \
  X(air_north) X(air_east) X(air_down) X(spin_north) X(spin_east) X(spin_down)                                      \
  X(integral) X(error) X(z_wanted) X(goal_north) X(goal_east) X(goal_down) X(goal_yaw) X(index) X(reached)          \
  X(throttle) X(pitch_wanted) X(roll_wanted) X(turn_wanted)                                                         \
  X(drift) X(roll_error) X(pitch_error) X(yaw_error)                                                                \
  X(gnss_north) X(gnss_east) X(gnss_down) X(gnss_vn) X(gnss_ve) X(gnss_vd) X(height) X(height_rate)                 \
  X(roll_read) X(pitch_read) X(yaw_read) X(gyro_x) X(gyro_y) X(gyro_z) X(acc_x) X(acc_y) X(acc_z) X(code) X(value)  \
  X(w0) X(w1) X(w2) X(w3) X(w4) X(w5) X(w6) X(w7) X(w8) X(w9) X(w10) X(w11) X(w12) X(w13) X(w14) X(w15)

struct alignas(BYTES) Block {
#define X(name) F name;
  FIELDS(X)
#undef X
};

enum Stream { TURBULENCE, PROCESS, BAROMETER, ATTITUDE, GYROSCOPE, ACCELEROMETER, STREAMS };

// Parameters that are not constants of the models; the area is that of patrol().
struct World {
  Key keys[STREAMS];
  float speed_20ft, sine, cosine, reach_x, reach_y, z_min;

  World(float speed, float reach) : keys{}, speed_20ft(speed), reach_x(reach), reach_y(reach), z_min(-100.0f) {
    const double from = 225.0 * M_PI / 180.0;
    sine = float(std::sin(from)), cosine = float(std::cos(from));
    for (uint32_t i = 0; i < STREAMS; i++) keys[i] = {0x9E3779B9u * (i + 1), 0x85EBCA6Bu * (i + 7)};
  }
};

constexpr float DT = 0.02f;
constexpr float FEET = float(1.0 / 0.3048);
constexpr double SPAN = 0.6, PITCH_LENGTH = 4.0 / M_PI * SPAN, YAW_LENGTH = 3.0 / M_PI * SPAN;
constexpr float SQRT_3 = 1.7320508f, COS_15 = 0.96592583f, SIN_15 = 0.25881905f;
constexpr int GNSS_TICKS = 10;

struct Vec3 {
  F x, y, z;
};

// ---- turbulence: MIL-F-8785C, 3.7.2; state and symbols as in models/dryden.py

struct Row {  // one step of (z1, z2, z3)
  F loss, cross, l11, l21, l22, lag_loss, f1, f2, l31, l32, l33;
};

// 1 - exp(-x), 0 <= x < 2
INLINE F one_minus_exp(F x) {
  return x * horner(x, -2.0e-8, 2.6e-7, -2.7477457e-6, 2.4799e-5, -1.98411e-4, 1.3888887e-3, -8.3333332e-3,
                    4.16666667e-2, -1.66666667e-1, 0.5, -1.0) * -1.0f;
}

// For x >= 1 or a lag far from x; rare, so one lane after the other in double precision.
__attribute__((noinline, cold)) void general_row(Row& row, F x, F lag, I where) {
  for (int i = 0; i < LANES; i++) {
    if (!where[i]) continue;
    double h = x[i], y = lag[i], r = y / h, a = std::exp(-h), d = y - h;
    double variance = -std::expm1(-2.0 * h), cross = 2.0 * h * a, l11 = std::sqrt(variance);
    double l22 = std::sqrt(variance - cross * cross / variance);
    double g = std::abs(d) < 1e-4 ? 1.0 - d / 2.0 : -std::expm1(-d) / d;
    double g1 = std::abs(d) < 1e-4 ? 0.5 - d / 6.0 : (1.0 - g) / d;
    double d0 = h * a * g, d1 = h * h * a * g1, twice = 2.0 * std::sqrt(r);
    double f2 = -twice * d0, f1 = -twice * (d0 - 2.0 * d1), l31 = -f1 * a / l11;
    double l32 = twice * (2.0 * d1 - (1.0 - variance / (2.0 * h)) * d0) * cross / (variance * l22);
    double rest = -std::expm1(-2.0 * y) - f1 * f1 - f2 * f2 - l31 * l31 - l32 * l32;
    row.loss[i] = float(-std::expm1(-h)), row.cross[i] = float(cross), row.l11[i] = float(l11);
    row.l21[i] = float(cross * a / l11), row.l22[i] = float(l22), row.lag_loss[i] = float(-std::expm1(-y));
    row.f1[i] = float(f1), row.f2[i] = float(f2), row.l31[i] = float(l31), row.l32[i] = float(l32);
    row.l33[i] = float(std::sqrt(std::max(rest, 1e-24)));
  }
}

INLINE Row filter_row(F x, F lag, F ratio) {
  F loss = one_minus_exp(x), a = 1.0f - loss, variance = loss * (2.0f - loss);
  F lag_loss = one_minus_exp(lag), lag_decay = 1.0f - lag_loss;
  F square = x * x;
  F excess_by_x = square * horner(square, 2.50521084e-8, 2.75573192e-6, 1.98412698e-4, 8.33333333e-3, 1.66666667e-1);
  F excess = excess_by_x * x, cross = 2.0f * x * a, inverse_l11 = inverse_root(variance);
  F l22_square = 2.0f * a * excess * (2.0f * x + excess) * inverse(x + excess), inverse_l22 = inverse_root(l22_square);
  F y = lag - x;
  F series = horner(y, -2.5052108e-8, 2.7557319e-7, -2.7557319e-6, 2.4801587e-5, -1.9841270e-4, 1.3888889e-3,
                    -8.3333333e-3, 4.1666667e-2, -1.6666667e-1, 0.5);
  F scale = x * a, d0 = scale * (1.0f - y * series), d1 = scale * x * series, twice_root = 2.0f * root(ratio);
  F f2 = -twice_root * d0, f1 = -twice_root * (d0 - 2.0f * d1);
  F unexplained = loss - a * excess_by_x;
  F l31 = -f1 * a * inverse_l11;
  F l32 = twice_root * (2.0f * d1 - unexplained * d0) * cross * (inverse_l11 * inverse_l11 * inverse_l22);
  F b = lag * lag, s = square;
  F order_2 = (9.0f * b - 10.0f * s) * (1.0f / 210.0f);
  F order_4 = ((5.0f * s - 22.0f * b) * s + 10.0f * b * b) * (1.0f / 12600.0f);
  F order_6 = (((2100.0f * s + 321.0f * b) * s - 820.0f * b * b) * s + 250.0f * b * b * b) * (1.0f / 29106000.0f);
  F sum = x + lag, sum_square = sum * sum;
  F third = lag * sum_square * sum_square * (1.0f / 360.0f) * lag_decay * (1.0f + (order_2 + (order_4 + order_6)));
  Row row = {loss, cross, variance * inverse_l11, cross * a * inverse_l11, l22_square * inverse_l22, lag_loss, f1, f2,
             l31, l32, root(third)};
  I large = (x >= 1.0f) | (magnitude(y) >= 1.0f);
  if (__builtin_expect(any(large), 0)) general_row(row, x, lag, large);
  return row;
}

INLINE void advance(F& z1, F& z2, F& z3, const Row& row, F n1, F n2, F n3) {
  F first = z1 + (row.l11 * n1 - row.loss * z1);
  F second = z2 + (row.l21 * n1 + row.l22 * n2 - row.loss * z2 - row.cross * z1);
  z3 = z3 + (row.l31 * n1 + row.l32 * n2 + row.l33 * n3 + (row.f1 * z1 + row.f2 * z2 - row.lag_loss * z3));
  z1 = first, z2 = second;
}

// The gust minus its lagged value.
INLINE F gust_change(F z1, F z2, F z3, F ratio, F root_ratio) {
  F i = inverse(1.0f + ratio), square = i * i;
  return COS_15 * i * z1 +
         0.35355339f * ((3.0f * SQRT_3 + 1.0f) * ratio + (SQRT_3 - 1.0f)) * square * z2 +
         0.70710678f * root_ratio * (SQRT_3 * ratio - 1.0f) * square * z3;
}

INLINE Vec3 wind_to_ned(F along, F across, F down, const World& world) {
  return {world.sine * across - world.cosine * along, -world.sine * along - world.cosine * across, down};
}

// Advances the gusts and returns the air's velocity.
INLINE Vec3 air_velocity(Block& s, const World& world, Vec3 velocity_ned, const F* n) {
  constexpr float LN_ROUGH = -1.8971200f, LN_10 = 2.3025851f, LN_1000 = 6.9077553f;
  F feet = s.down * -FEET;
  F ln_ratio = logarithm(larger(feet * (1.0f / 0.15f), all(1.0f)));
  F mean = world.speed_20ft * ln_ratio * float(1.0 / std::log(20.0 / 0.15));
  Vec3 wind = wind_to_ned(mean, F{}, F{}, world);

  F low_feet = clip(feet, 10.0f, 1000.0f), ln_feet = clip(ln_ratio + LN_ROUGH, LN_10, LN_1000);
  F ratio = exponential(-0.4f * logarithm(0.177f + 0.000823f * low_feet));
  F length_z = low_feet * 0.3048f, length_y = length_z * ratio * ratio * ratio;
  F sigma_z = all(0.1f * world.speed_20ft), sigma_y = sigma_z * ratio;
  // The area's ceiling is far below 1000 ft, above which other scales hold.

  F x = velocity_ned.x - wind.x, y = velocity_ned.y - wind.y, z = velocity_ned.z - wind.z;
  F way = DT * root(larger(x * x + y * y + z * z, all(0.25f)));
  F lag_r = way * float(1.0 / YAW_LENGTH), lag_q = way * float(1.0 / PITCH_LENGTH);
  F ratio_y = length_y * float(1.0 / YAW_LENGTH), ratio_z = length_z * float(1.0 / PITCH_LENGTH);
  F way_y = way / length_y;
  Row across = filter_row(way_y, lag_r, ratio_y), down = filter_row(way / length_z, lag_q, ratio_z);
  s.along = s.along + (across.l11 * n[0] - across.loss * s.along);
  advance(s.across1, s.across2, s.across3, across, n[1], n[2], n[6]);
  advance(s.down1, s.down2, s.down3, down, n[3], n[4], n[7]);
  F p_spread = root(down.lag_loss * (2.0f - down.lag_loss));
  s.roll_gust = s.roll_gust + (p_spread * n[5] - down.lag_loss * s.roll_gust);

  static const float ROLL_FACTOR = float(M_PI * std::sqrt(0.1) * std::pow(M_PI / 4.0, 1.0 / 6.0));
  static const float LN_SPAN = float(2.0 * std::log(SPAN) + std::log(0.3048));
  F spin_x = ROLL_FACTOR * sigma_z * exponential((ln_feet + LN_SPAN) * float(-1.0 / 3.0)) * s.roll_gust;
  F change_z = gust_change(s.down1, s.down2, s.down3, ratio_z, root(ratio_z));
  F change_y = gust_change(s.across1, s.across2, s.across3, ratio_y, root(ratio_y));
  Vec3 spin = wind_to_ned(spin_x, sigma_z * float(1.0 / PITCH_LENGTH) * change_z,
                          -sigma_y * float(1.0 / YAW_LENGTH) * change_y, world);
  s.spin_north = spin.x, s.spin_east = spin.y, s.spin_down = spin.z;
  Vec3 gust = wind_to_ned(sigma_y * s.along, sigma_y * (COS_15 * s.across1 + SIN_15 * s.across2),
                          sigma_z * (COS_15 * s.down1 + SIN_15 * s.down2), world);
  return {wind.x + gust.x, wind.y + gust.y, wind.z + gust.z};
}

// ---- vehicle: Symington et al. 2014, eqs. 1-6

struct Body {
  F v[13];  // north, east, down, roll, pitch, yaw, u, v, w, p, q, r, thrust
};

struct Rotation {  // rows are the body axes in NED
  F m[9];
  Trig roll, pitch;
};

INLINE Rotation rotation(F roll, F pitch, F yaw) {
  Trig a = sincos(roll), b = sincos(pitch), c = sincos(yaw);
  F sr = a.sine, cr = a.cosine, sp = b.sine, cp = b.cosine, sy = c.sine, cy = c.cosine;
  F srsp = sr * sp, crsp = cr * sp;
  return {{cp * cy, cp * sy, -sp, srsp * cy - cr * sy, srsp * sy + cr * cy, sr * cp, crsp * cy + sr * sy,
           crsp * sy - sr * cy, cr * cp}, a, b};
}

INLINE Vec3 to_ned(const Rotation& d, F x, F y, F z) {
  const F* m = d.m;
  return {m[0] * x + m[3] * y + m[6] * z, m[1] * x + m[4] * y + m[7] * z, m[2] * x + m[5] * y + m[8] * z};
}

struct Command {
  F pitch, roll, throttle, turn;
};

INLINE F rate_limited(F acceleration, F rate) {
  I outward = (magnitude(rate) >= float(150.0 * M_PI / 180.0)) & (acceleration * rate > 0.0f);
  return outward ? F{} : acceleration;
}

INLINE void slope(const Body& body, const Rotation& d, const Command& command, Vec3 air, const F* noise, Body& rate,
                  Vec3& force) {
  constexpr float G = 9.81f, MASS = 1.68f, KUV = -0.497391f, KW = -1.35341f;
  constexpr float CEILING = float(-18.0007 + 4.23754 * 12.0), TAU0 = 3.07321f, TAU1 = 46.8004f;
  constexpr float TILT = float(1.79797e2 * -3.25060e-4 / (-0.025 * M_PI / 180.0));
  constexpr float TURN = float(-4.81783e-3 / (-254.760 / 2047.0 * M_PI / 180.0));
  const F* m = d.m;
  F u = body.v[6], v = body.v[7], w = body.v[8], p = body.v[9], q = body.v[10], r = body.v[11], thrust = body.v[12];
  F raw = command.throttle * 4097.0f;
  F wanted = smaller(6.63881e-01f + raw * (7.44649e-04f + raw * 2.39855e-06f), all(CEILING)) - thrust;
  rate.v[12] = raw < 300.0f ? TAU0 * wanted : clip(wanted * (1.0f / DT), -TAU1, TAU1);
  F lift = (thrust + DT * rate.v[12]) * (1.0f / MASS);
  F ru = u - (m[0] * air.x + m[1] * air.y + m[2] * air.z);
  F rv = v - (m[3] * air.x + m[4] * air.y + m[5] * air.z);
  F rw = w - (m[6] * air.x + m[7] * air.y + m[8] * air.z);
  force = {KUV * ru + noise[0], KUV * rv + noise[1], KW * rw - lift + noise[2]};
  Vec3 way = to_ned(d, u, v, w);
  rate.v[0] = way.x, rate.v[1] = way.y, rate.v[2] = way.z;
  F yaw_rate = (q * d.roll.sine + r * d.roll.cosine) * inverse(d.pitch.cosine);
  rate.v[3] = p + yaw_rate * d.pitch.sine, rate.v[4] = q * d.roll.cosine - r * d.roll.sine, rate.v[5] = yaw_rate;
  rate.v[6] = force.x + G * m[2] - (q * w - r * v);
  rate.v[7] = force.y + G * m[5] - (r * u - p * w);
  rate.v[8] = force.z + G * m[8] - (p * v - q * u);
  rate.v[9] = rate_limited(TILT * command.roll - 179.797f * body.v[3] - 24.3536f * p, p) + noise[3];
  rate.v[10] = rate_limited(TILT * command.pitch - 179.797f * body.v[4] - 24.3536f * q, q) + noise[4];
  rate.v[11] = TURN * command.turn - 5.08944f * r + noise[5];
}

// ---- route and waypoint controller: docs/explanation/models/control.md

__attribute__((noinline, cold)) void next_waypoint(Block& s, I arrived) {
  const F* ways = &s.w0;
  for (int i = 0; i < LANES; i++) {
    if (!arrived[i]) continue;
    int next = (int(s.index[i]) + 1) % 4;
    s.index[i] = float(next), s.reached[i] += 1.0f;
    s.goal_north[i] = ways[4 * next][i], s.goal_east[i] = ways[4 * next + 1][i];
    s.goal_down[i] = ways[4 * next + 2][i], s.goal_yaw[i] = ways[4 * next + 3][i];
  }
}

INLINE Command control(Block& s) {
  constexpr float TILT = 0.6f;
  F z = -s.height, north = s.goal_north - s.gnss_north, east = s.goal_east - s.gnss_east, down = s.goal_down - z;
  I arrived = north * north + east * east + down * down < 64.0f;
  if (__builtin_expect(any(arrived), 0)) {
    next_waypoint(s, arrived);
    north = s.goal_north - s.gnss_north, east = s.goal_east - s.gnss_east;
  }
  Trig yaw = sincos(s.yaw_read);
  F u = yaw.cosine * s.gnss_vn + yaw.sine * s.gnss_ve, v = yaw.cosine * s.gnss_ve - yaw.sine * s.gnss_vn;
  F u_wanted = clip(0.9f * (yaw.cosine * north + yaw.sine * east), -5.0f, 5.0f);
  F v_wanted = clip(0.9f * (yaw.cosine * east - yaw.sine * north), -5.0f, 5.0f);
  F turn = s.goal_yaw - s.yaw_read;
  turn = turn - 6.2831853f * nearest(turn * 0.15915494f);
  F error = z - s.goal_down;
  F rate = s.goal_down == s.z_wanted ? (error - s.error) * (1.0f / DT) : F{};
  F integral = s.integral + error * DT;
  F unclipped = 0.59f + 0.03f * error + 0.0008f * integral + 0.04f * rate;
  F throttle = clip(unclipped, 0.0f, 1.0f);
  s.integral = integral - 2.0f * (unclipped - throttle), s.error = error, s.z_wanted = s.goal_down;
  return {clip(0.09f * (u - u_wanted), -TILT, TILT), clip(0.09f * (v_wanted - v), -TILT, TILT), throttle,
          clip(6.0f * turn, -4.4f, 4.4f)};
}

// ---- limits: docs/howto/write_a_scenario.md

constexpr float LARGEST[9] = {float(M_PI), float(89.0 * M_PI / 180.0), float(10.0 * M_PI), 15.0f, 15.0f, 15.0f,
                              6.0f, 6.0f, 6.0f};

// Written so that what is not a number is broken, too.
INLINE I broken_by(const Body& body, const World& world) {
  const F* v = body.v;
  I fine = (magnitude(v[0]) <= world.reach_x) & (magnitude(v[1]) <= world.reach_y) & (v[2] >= world.z_min) &
           (v[2] <= 0.0f) & (magnitude(v[12]) < 1e30f);
  for (int k = 0; k < 9; k++) fine &= magnitude(v[3 + k]) <= LARGEST[k];
  return ~fine;
}

// Stops what broke a limit in this step or before: it stays where it was, at rest, and its readings are NaN.
__attribute__((noinline, cold)) void stop(Block& s, Body& body, const Body& old, const World& world, I broken) {
  for (int i = 0; i < LANES; i++) {
    if (!broken[i] && s.code[i] == 0.0f) continue;
    if (s.code[i] == 0.0f) {
      float v[13];
      for (int k = 0; k < 13; k++) v[k] = body.v[k][i];
      int code = 0, which = 0;
      for (int k = 0; k < 13 && code == 0; k++)
        if (!std::isfinite(v[k])) code = 1, which = -1;
      if (code == 0 && std::abs(v[0]) > world.reach_x) code = 2, which = 0;
      if (code == 0 && std::abs(v[1]) > world.reach_y) code = 3, which = 1;
      if (code == 0 && (v[2] < world.z_min || v[2] > 0.0f)) code = 4, which = 2;
      for (int k = 0; k < 9 && code == 0; k++)
        if (std::abs(v[3 + k]) > LARGEST[k]) code = 5 + k, which = 3 + k;
      s.code[i] = float(code), s.value[i] = which < 0 ? 0.0f : v[which];
    }
    for (int k = 0; k < 13; k++) body.v[k][i] = 6 <= k && k < 12 ? 0.0f : old.v[k][i];
  }
}

__attribute__((noinline, cold)) void silence(Block& s) {
  I stopped = s.code != 0.0f;
  for (F* reading = &s.gnss_north; reading <= &s.acc_z; reading++)
    *reading = stopped ? all(std::numeric_limits<float>::quiet_NaN()) : *reading;
}

// ---- one step of a vector of vehicles, from tick to tick + 1

constexpr int PAIRS = 14, TOGETHER = 7;
constexpr Stream PAIR_STREAM[PAIRS] = {TURBULENCE, TURBULENCE, TURBULENCE, TURBULENCE, PROCESS, PROCESS, PROCESS,
                                       BAROMETER, ATTITUDE, ATTITUDE, GYROSCOPE, GYROSCOPE, ACCELEROMETER,
                                       ACCELEROMETER};
constexpr uint32_t PAIR_INDEX[PAIRS] = {0, 1, 2, 3, 0, 1, 2, 0, 0, 1, 0, 1, 0, 1};

INLINE void sense(Block& s, const Body& body, Vec3 force, const F* n, uint32_t after) {
  static const float BARO = float(std::exp(-0.02 / 300.0));
  static const float BARO_N = float(0.26 * std::sqrt(-std::expm1(-0.04 / 300.0)));
  static const float ATT = float(std::exp(-0.02 / 100.0));
  static const float ATT_N = float(0.00354 * std::sqrt(-std::expm1(-0.04 / 100.0)));
  s.drift = BARO * s.drift + BARO_N * n[14];
  F height = s.drift - body.v[2];
  s.height_rate = (height - s.height) * (1.0f / DT), s.height = height;
  s.roll_error = ATT * s.roll_error + ATT_N * n[16], s.roll_read = body.v[3] + s.roll_error;
  s.pitch_error = ATT * s.pitch_error + ATT_N * n[17], s.pitch_read = body.v[4] + s.pitch_error;
  s.yaw_error = ATT * s.yaw_error + ATT_N * n[18], s.yaw_read = body.v[5] + s.yaw_error;
  s.gyro_x = body.v[9] + 0.0002f * n[20], s.gyro_y = body.v[10] + 0.0002f * n[21];
  s.gyro_z = body.v[11] + 0.0002f * n[22];
  s.acc_x = force.x + 0.0025f * n[24], s.acc_y = force.y + 0.0025f * n[25], s.acc_z = force.z + 0.0025f * n[26];
  if (after % GNSS_TICKS == 0) {
    Rotation d = rotation(body.v[3], body.v[4], body.v[5]);
    Vec3 velocity = to_ned(d, body.v[6], body.v[7], body.v[8]);
    s.gnss_north = body.v[0], s.gnss_east = body.v[1], s.gnss_down = body.v[2];
    s.gnss_vn = velocity.x, s.gnss_ve = velocity.y, s.gnss_vd = velocity.z;
  }
}

INLINE void step(Block& s, const World& world, U id, uint32_t tick) {
  F n[2 * PAIRS];
  for (int i = 0; i < PAIRS; i += TOGETHER) {
    Key keys[TOGETHER];
    Words words[TOGETHER];
    for (int k = 0; k < TOGETHER; k++) {
      Key key = world.keys[PAIR_STREAM[i + k]];
      keys[k] = {key.high, key.low + PAIR_INDEX[i + k]};
    }
    threefry<TOGETHER>(keys, tick + 1, id, words);
    for (int k = 0; k < TOGETHER; k++) {
      Normals pair = box_muller(words[k]);
      n[2 * (i + k)] = pair.first, n[2 * (i + k) + 1] = pair.second;
    }
  }
  Body body, first, middle, second;
  for (int k = 0; k < 13; k++) body.v[k] = (&s.north)[k];
  Rotation d = rotation(body.v[3], body.v[4], body.v[5]);
  Vec3 air = air_velocity(s, world, to_ned(d, body.v[6], body.v[7], body.v[8]), n);
  s.air_north = air.x, s.air_east = air.y, s.air_down = air.z;
  Command command = control(s);
  s.throttle = command.throttle, s.pitch_wanted = command.pitch;
  s.roll_wanted = command.roll, s.turn_wanted = command.turn;
  F noise[6];
  for (int k = 0; k < 6; k++) noise[k] = 0.2f * n[8 + k];
  Vec3 force_1, force_2;
  slope(body, d, command, air, noise, first, force_1);
  for (int k = 0; k < 13; k++) middle.v[k] = body.v[k] + DT * first.v[k];
  slope(middle, rotation(middle.v[3], middle.v[4], middle.v[5]), command, air, noise, second, force_2);
  Body next;
  for (int k = 0; k < 13; k++) next.v[k] = body.v[k] + 0.5f * DT * (first.v[k] + second.v[k]);
  Vec3 force = {0.5f * (force_1.x + force_2.x), 0.5f * (force_1.y + force_2.y), 0.5f * (force_1.z + force_2.z)};
  I broken = broken_by(next, world) | (s.code != 0.0f);
  bool stopped = any(broken);
  if (__builtin_expect(stopped, 0)) stop(s, next, body, world, broken);
  for (int k = 0; k < 13; k++) (&s.north)[k] = next.v[k];
  sense(s, next, force, n, tick + 1);
  if (__builtin_expect(stopped, 0)) silence(s);
}

void fly(Block* blocks, int first, int count, const World& world, uint32_t tick, int ticks) {
  U lane;
  for (int i = 0; i < LANES; i++) lane[i] = uint32_t(i);
  // All vehicles of a tick before the next tick, as a world must that looks at all positions together.
  for (int t = 0; t < ticks; t++)
    for (int b = first; b < first + count; b++) step(blocks[b], world, lane + uint32_t(LANES * b), tick + uint32_t(t));
}

// ---- what bound.py asks for

double seconds_of(clockid_t clock) {
  timespec now;
  clock_gettime(clock, &now);
  return double(now.tv_sec) + 1e-9 * double(now.tv_nsec);
}

// Each vehicle at a corner of its own square, at rest, as patrol() of _common.py places them.
void place(Block& s, int lane, int number, int columns) {
  const float heights[5] = {20.0f, 30.0f, 40.0f, 50.0f, 60.0f}, corners[4][2] = {{0, 40}, {40, 40}, {40, 0}, {0, 0}};
  float middle = 0.5f * float(columns - 1);
  float north = (float(number / columns) - middle) * 80.0f, east = (float(number % columns) - middle) * 80.0f;
  float down = -heights[number % 5];
  F* ways = &s.w0;
  for (int k = 0; k < 4; k++) {
    ways[4 * k][lane] = north + corners[k][0], ways[4 * k + 1][lane] = east + corners[k][1];
    ways[4 * k + 2][lane] = down;
  }
  s.north[lane] = s.gnss_north[lane] = s.goal_north[lane] = north, s.gnss_east[lane] = s.east[lane] = east;
  s.goal_east[lane] = east + 40.0f, s.down[lane] = s.gnss_down[lane] = s.goal_down[lane] = down;
  s.height[lane] = -down, s.thrust[lane] = 1.68f * 9.81f, s.z_wanted[lane] = 1e9f;
}

int run(int vehicles, int ticks, int repeats, int threads) {
  int count = (vehicles + LANES - 1) / LANES, columns = int(std::ceil(std::sqrt(double(vehicles))));
  std::vector<Block> blocks(size_t(count), Block{});
  for (int i = 0; i < count * LANES; i++) place(blocks[size_t(i / LANES)], i % LANES, i, columns);
  World world(5.0f, 80.0f * float(columns) + 200.0f);
  uint32_t tick = 0;
  for (int repeat = -1; repeat < repeats; repeat++) {  // the first one warms up
    double wall = seconds_of(CLOCK_MONOTONIC), cpu = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
    std::vector<std::thread> workers;
    for (int k = 0; k < threads; k++) {
      int from = count * k / threads, to = count * (k + 1) / threads;
      workers.emplace_back(fly, blocks.data(), from, to - from, std::cref(world), tick, ticks);
    }
    for (std::thread& worker : workers) worker.join();
    wall = seconds_of(CLOCK_MONOTONIC) - wall, cpu = seconds_of(CLOCK_PROCESS_CPUTIME_ID) - cpu;
    tick += uint32_t(ticks);
    int flying = 0;
    for (int i = 0; i < vehicles; i++) flying += blocks[size_t(i / LANES)].code[i % LANES] == 0.0f;
    if (repeat >= 0) std::printf("%.9g %.9g %d\n", wall, cpu, flying);
  }
  return 0;
}

int check(uint32_t first, int ticks, float speed) {
  World world(speed, 1e5f);
  for (Key& key : world.keys)
    if (std::scanf("%u %u", &key.high, &key.low) != 2) return 1;
  constexpr int VEHICLES = 16;
  Block blocks[VEHICLES / LANES] = {};
  const char* names[] = {
#define X(name) #name,
      FIELDS(X)
#undef X
  };
  const int count = int(sizeof(Block) / sizeof(F));
  char name[64];
  while (std::scanf("%63s", name) == 1) {
    int k = 0;
    while (k < count && std::strcmp(names[k], name) != 0) k++;
    for (int i = 0; i < VEHICLES; i++) {
      float value;
      if (k == count || std::scanf("%f", &value) != 1) return 1;
      (&blocks[i / LANES].north)[k][i % LANES] = value;
    }
  }
  fly(blocks, 0, VEHICLES / LANES, world, first, ticks);
  for (int k = 0; k < count; k++) {
    std::printf("%s", names[k]);
    for (int i = 0; i < VEHICLES; i++) std::printf(" %.9g", (&blocks[i / LANES].north)[k][i % LANES]);
    std::printf("\n");
  }
  return 0;
}

int words(Key key, uint32_t tick, int count) {
  for (int b = 0; b < count; b += LANES) {
    U id;
    for (int i = 0; i < LANES; i++) id[i] = uint32_t(b + i);
    Words drawn;
    threefry<1>(&key, tick, id, &drawn);
    Normals normals = box_muller(drawn);
    for (int i = 0; i < LANES && b + i < count; i++)
      std::printf("%u %u %.9g %.9g\n", drawn.first[i], drawn.second[i], normals.first[i], normals.second[i]);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  auto number = [&](int i) { return uint32_t(std::strtoul(argv[i], nullptr, 10)); };
  std::string mode = argc > 1 ? argv[1] : "";
  if (mode == "run" && argc == 6) return run(int(number(2)), int(number(3)), int(number(4)), int(number(5)));
  if (mode == "check" && argc == 5) return check(number(2), int(number(3)), std::strtof(argv[4], nullptr));
  if (mode == "words" && argc == 6) return words({number(2), number(3)}, number(4), int(number(5)));
  std::fprintf(stderr, "usage: bound run VEHICLES TICKS REPEATS THREADS | check FIRST TICKS SPEED_20FT | "
                       "words KEY_HIGH KEY_LOW TICK COUNT\n");
  return 2;
}
