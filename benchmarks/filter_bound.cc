// The practical limit of one step of the Kalman filter on a CPU, for bound.py: by hand, in vectors; no part of the
// package.
//
// The step is that of the default scenario's filter: 21 errors (position, velocity, rotation, two biases, magnetic field
// and its bias), half a covariance, fixes that are ten ticks late, and gates. It propagates at every tick, and a height
// corrects it then; a fix with a velocity does every tenth tick, and a magnetic field every fifth. The scalars of one
// reading share one pass over the covariance. Equations F1 to F3: docs/explanation/models/estimators.md.
//
// Arguments: run VEHICLES TICKS REPEATS THREADS   prints "wall_seconds cpu_seconds finite" of each repeat
//            check VEHICLES TICKS                 prints the states after TICKS, a row for each field
// Standard input: for both the parameters, then for each vehicle in a column the rows of readings and of states.

#include <cmath>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <string>
#include <thread>
#include <type_traits>
#include <vector>

#include "vectors.h"

namespace {

constexpr int SIZE = 21, HALF = SIZE * (SIZE + 1) / 2, LATE = 10, FIX_TICKS = 10, FIELD_TICKS = 5;
// Numbers of the first error of each kind.
constexpr int PLACE = 0, SPEED = 3, TURN = 6, GYROSCOPE = 9, ACCELEROMETER = 12, EARTH = 15, BIAS = 18;
// One tile: the vehicles whose ticks alternate, 8 in each world of a vector.
constexpr int TILE = 8;
constexpr float DT = 0.02f, BACK = 0.1f, LEAN_S = 20.0f;

struct Vec3 {
  F x, y, z;
};

INLINE Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
INLINE Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
INLINE Vec3 operator*(Vec3 a, F s) { return {a.x * s, a.y * s, a.z * s}; }
INLINE Vec3 operator*(Vec3 a, float s) { return {a.x * s, a.y * s, a.z * s}; }
INLINE F dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE Vec3 cross(Vec3 a, Vec3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
INLINE I finite(F x) { return magnitude(x) < INFINITY; }
INLINE Vec3 known(Vec3 now, Vec3 before) {
  return {finite(now.x) ? now.x : before.x, finite(now.y) ? now.y : before.y, finite(now.z) ? now.z : before.z};
}

struct Quaternion {
  F w, x, y, z;
};

INLINE Quaternion operator*(const Quaternion& a, const Quaternion& b) {
  return {a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
          a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}

INLINE Quaternion normalised(Quaternion q) {
  F scale = inverse_root(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  return {q.w * scale, q.x * scale, q.y * scale, q.z * scale};
}

// From half the rotation vector of a small rotation.
INLINE Quaternion small(Vec3 half) {
  F square = dot(half, half), scale = 1.0f - square * (1.0f / 6.0f);
  return {1.0f - 0.5f * square, half.x * scale, half.y * scale, half.z * scale};
}

struct Rotation {  // the body axes in NED
  Vec3 forward, right, down;
};

INLINE Rotation rotation(Quaternion q) {
  F xx = q.x * q.x, yy = q.y * q.y, zz = q.z * q.z, xy = q.x * q.y, xz = q.x * q.z, yz = q.y * q.z;
  F wx = q.w * q.x, wy = q.w * q.y, wz = q.w * q.z;
  return {{1.0f - 2.0f * (yy + zz), 2.0f * (xy + wz), 2.0f * (xz - wy)},
          {2.0f * (xy - wz), 1.0f - 2.0f * (xx + zz), 2.0f * (yz + wx)},
          {2.0f * (xz + wy), 2.0f * (yz - wx), 1.0f - 2.0f * (xx + yy)}};
}

INLINE Vec3 to_ned(const Rotation& d, Vec3 v) { return d.forward * v.x + d.right * v.y + d.down * v.z; }

struct Parameters {
  float gyroscope_noise, accelerometer_noise, gyroscope_walk, accelerometer_walk, field_walk, gyroscope_scale,
      accelerometer_scale, gyroscope_g_sensitivity, height_std, field_std, field_scale, sampling, gate, reset_after,
      gravity;
};

struct Readings {
  Vec3 rates, force, fix, velocity;
  F horizontal, vertical, speed, hdop, vdop, height;
  Vec3 field;
};

struct Past {
  Vec3 position, low, velocity;
};

// In the order of the leaves of qrsim's KalmanState; ``past`` is a ring, whose entry t % LATE is of tick t.
struct State {
  Vec3 position, low, velocity;
  Quaternion attitude;
  Vec3 gyroscope_bias, accelerometer_bias, earth, field_bias, rates, force;
  F covariance[HALF];
  Vec3 lean;
  F since_fix, shown_position, shown_velocity, shown_height, shown_yaw, shown_field;
  Past past[LATE];
  Vec3 slow;
};

struct alignas(BYTES) Block {
  Readings readings;
  State state;
};

constexpr int at(int i, int j) { return i <= j ? i * SIZE - i * (i - 1) / 2 + j - i : at(j, i); }

INLINE void add(Vec3& high, Vec3& low, Vec3 change) {
  Vec3 total = high + change;
  low = change - (total - high), high = total;
}

// Calls ``body`` with the constants from A to B - 1, so that no loop and no index is left.
#define UNROLLED [&](auto constant) __attribute__((always_inline))
template <int A, int B, typename Body>
INLINE void each(Body&& body) {
  if constexpr (A < B) {
    body(std::integral_constant<int, A>{});
    each<A + 1, B>(body);
  }
}

// ---- covariance: F P F' + Q in place, row after row

// F right of its diagonal: ``forces`` are the terms of specific force by rotation, ``axes`` those of the biases.
struct Moves {
  F forces[3][2], axes[3][3];
};

constexpr int FORCE_COLUMNS[3][2] = {{TURN + 1, TURN + 2}, {TURN, TURN + 2}, {TURN, TURN + 1}};

// Row ``ROW`` of F times numbers that ``read`` returns by their columns.
template <int ROW, typename Read>
INLINE F moved(const Moves& moves, Read&& read) {
  F sum = read(std::integral_constant<int, ROW>{});
  if constexpr (ROW < SPEED) {
    sum += DT * read(std::integral_constant<int, ROW + 3>{});
  } else if constexpr (ROW < TURN) {
    constexpr int AXIS = ROW - SPEED;
    each<0, 2>(UNROLLED {
      sum += moves.forces[AXIS][constant] * read(std::integral_constant<int, FORCE_COLUMNS[AXIS][constant]>{});
    });
    each<0, 3>(UNROLLED {
      sum += moves.axes[AXIS][constant] * read(std::integral_constant<int, ACCELEROMETER + constant>{});
    });
  } else if constexpr (ROW < GYROSCOPE) {
    constexpr int AXIS = ROW - TURN;
    each<0, 3>(UNROLLED {
      sum += moves.axes[AXIS][constant] * read(std::integral_constant<int, GYROSCOPE + constant>{});
    });
  }
  return sum;
}

template <int ROW>
INLINE void propagate_row(F* P, const Moves& moves, const F* noise) {
  F row[SIZE];
  each<ROW, SIZE>(UNROLLED {
    constexpr int J = constant;
    row[J] = moved<ROW>(moves, [&](auto k) __attribute__((always_inline)) { return P[at(k, J)]; });
  });
  each<ROW, SIZE>(UNROLLED {
    constexpr int J = constant;
    F sum = moved<J>(moves, [&](auto k) __attribute__((always_inline)) { return row[k]; });
    P[at(ROW, J)] = J == ROW ? sum + noise[J] : sum;
  });
}

INLINE void propagate(F* P, const Moves& moves, const F* noise) {
  each<0, GYROSCOPE>(UNROLLED { propagate_row<constant>(P, moves, noise); });
  each<GYROSCOPE, SIZE>(UNROLLED { P[at(constant, constant)] += noise[constant]; });
}

// ---- scalar measurements

// Sensitive to the errors of these numbers, to the first by one.
template <int FIRST, int... OTHERS>
struct Scalar {
  F innovation, variance, factors[sizeof...(OTHERS) + 1];

  template <typename Read>
  INLINE F times(Read&& read) const {
    F sum = read(std::integral_constant<int, FIRST>{});
    int k = 0;
    ((sum += factors[k++] * read(std::integral_constant<int, OTHERS>{})), ...);
    return sum;
  }
  INLINE F expected(const F* errors) const {
    return times([&](auto k) __attribute__((always_inline)) { return errors[k]; });
  }
};

// A scalar with its column P H'.
template <typename S>
struct Used {
  S scalar;
  F column[SIZE];

  // Returns the squared innovation over its variance.
  INLINE F cross(const F* P, const F* errors) {
    each<0, SIZE>(UNROLLED {
      constexpr int I = constant;
      column[I] = scalar.times([&](auto k) __attribute__((always_inline)) { return P[at(I, k)]; });
    });
    F left = scalar.innovation - scalar.expected(errors);
    return left * left * inverse(scalar.expected(column) + scalar.variance);
  }
  INLINE void without(const F* other) {
    F share = scalar.expected(other);
    each<0, SIZE>(UNROLLED { column[constant] -= other[constant] * share; });
  }
  INLINE void correct(F* errors, I used) {
    F left = used ? scalar.innovation - scalar.expected(errors) : F{};
    F scale = used ? inverse_root(scalar.expected(column) + scalar.variance) : F{};
    F gain = left * scale;
    each<0, SIZE>(UNROLLED { column[constant] *= scale, errors[constant] += column[constant] * gain; });
  }
};

// Changes the covariance once, by all scalars of a reading.
template <typename... Columns>
INLINE void lower(F* P, const Columns&... columns) {
  // Loops of few instructions, as those of all numbers would not fit the first cache of code.
  F* row = P;
  for (int i = 0; i < SIZE; row += SIZE - i, i++) {
#pragma GCC unroll 4
    for (int j = i; j < SIZE; j++) {
      F sum = row[j - i];
      ((sum -= columns[i] * columns[j]), ...);
      row[j - i] = sum;
    }
  }
}

template <typename A, typename B, typename C>
INLINE I measure(State& s, F* errors, const A& a, const B& b, const C& c, F& shown, float gate) {
  Used<A> first{a, {}};
  Used<B> second{b, {}};
  Used<C> third{c, {}};
  F worst = larger(first.cross(s.covariance, errors), second.cross(s.covariance, errors));
  worst = larger(worst, third.cross(s.covariance, errors));
  I seen = finite(a.innovation) & finite(b.innovation) & finite(c.innovation), used = seen & (worst <= gate * gate);
  first.correct(errors, used);
  second.without(first.column), second.correct(errors, used);
  third.without(first.column), third.without(second.column), third.correct(errors, used);
  lower(s.covariance, first.column, second.column, third.column);
  shown = seen ? root(worst) : shown;
  return used;
}

// A fix after too many that were rejected: motion is forgotten. Rare, and not what is timed.
__attribute__((noinline, cold)) void forget(F* P, F level, I where) {
  for (int i = 0; i < SIZE; i++)
    for (int j = i; j < SIZE; j++) {
      // Height is kept, because the barometer measures it.
      bool gone = i < 2 || (i >= SPEED && i < SPEED + 2) || (i >= TURN && i < GYROSCOPE);
      gone |= j < 2 || (j >= SPEED && j < SPEED + 2) || (j >= TURN && j < GYROSCOPE);
      F fresh = i != j ? F{} : i < 2 ? 1e4f * level : i < TURN ? all(100.0f) : all(0.04f);
      if (gone) P[at(i, j)] = where ? fresh : P[at(i, j)];
    }
}

// ---- one step of a vector of vehicles, from tick to tick + 1

INLINE Rotation predict(State& s, const Readings& r, const Parameters& p) {
  Vec3 rates = known(r.rates, s.rates), turning = rates - s.gyroscope_bias, swing = rates - s.rates;
  Rotation before = rotation(s.attitude);
  s.attitude = normalised(s.attitude * small(turning * (0.5f * DT)));
  Rotation after = rotation(s.attitude);
  Vec3 body = r.force - s.accelerometer_bias, felt = (to_ned(before, body) + to_ned(after, body)) * 0.5f;
  I seen = finite(felt.x) & finite(felt.y) & finite(felt.z);
  felt = {seen ? felt.x : F{}, seen ? felt.y : F{}, seen ? felt.z : all(-p.gravity)};
  Vec3 change = {felt.x * DT, felt.y * DT, (felt.z + p.gravity) * DT};
  add(s.position, s.low, s.low + (s.velocity + change * 0.5f) * DT);
  Vec3 away = Vec3{after.forward.z, after.right.z, after.down.z} - s.lean;
  F leant = dot(away, away) * (2.0f * DT / LEAN_S);
  s.lean = s.lean + away * (DT / LEAN_S);

  F turned = (magnitude(turning.z) + BACK * (magnitude(turning.x) + magnitude(turning.y))) * DT;
  auto square = [](float x) { return x * x; };
  F turn = square(p.gyroscope_scale) * turned + square(p.sampling * DT) * dot(swing, swing);
  F speed = square(p.accelerometer_scale) / DT * dot(change, change);
  F lever = square(p.gyroscope_g_sensitivity * p.gravity) * leant;
  F drift = square(p.field_scale) * dot(s.earth, s.earth) * turned;
  const float walks[7] = {0.0f, p.accelerometer_noise, p.gyroscope_noise, p.gyroscope_walk, p.accelerometer_walk,
                          p.field_walk, p.field_walk};
  const F more[7] = {F{}, speed, turn, lever, F{}, F{}, drift};
  F noise[SIZE];
  for (int k = 0; k < SIZE; k++) noise[k] = more[k / 3] + square(walks[k / 3]) * DT;

  F fx = felt.x * DT, fy = felt.y * DT, fz = felt.z * DT;
  Vec3 x = after.forward * -DT, y = after.right * -DT, z = after.down * -DT;
  Moves moves = {{{fz, -fy}, {-fz, fx}, {fy, -fx}}, {{x.x, y.x, z.x}, {x.y, y.y, z.y}, {x.z, y.z, z.z}}};
  propagate(s.covariance, moves, noise);
  s.velocity = s.velocity + change, s.rates = rates, s.force = felt, s.since_fix += DT;
  return after;
}

INLINE void by_fix(State& s, const Readings& r, const Rotation& d, const Parameters& p, const Past& then, F* errors) {
  const float late = DT * LATE;
  F level = 0.5f * r.horizontal * r.horizontal;
  Used<Scalar<PLACE, SPEED>> north{{r.fix.x - then.position.x - then.low.x, level, {all(-late)}}, {}};
  Used<Scalar<PLACE + 1, SPEED + 1>> east{{r.fix.y - then.position.y - then.low.y, level, {all(-late)}}, {}};
  F worst = larger(north.cross(s.covariance, errors), east.cross(s.covariance, errors));
  I seen = finite(north.scalar.innovation) & finite(east.scalar.innovation), used = seen & (worst <= p.gate * p.gate);
  I again = seen & ~used & (s.since_fix > p.reset_after);
  bool lost = any(again);
  if (__builtin_expect(lost, 0)) forget(s.covariance, level, again), used |= again;
  s.since_fix = used ? F{} : s.since_fix;
  // The slow errors of other accuracies are others, of which a part of the position is not known.
  F slow[2] = {used ? level : s.slow.x, used ? level : s.slow.y};
  F jumps[2] = {magnitude(slow[0] - s.slow.x), magnitude(slow[1] - s.slow.y)};
  s.slow.x = slow[0], s.slow.y = slow[1];
  s.covariance[at(0, 0)] += jumps[0], s.covariance[at(1, 1)] += jumps[1];
  north.column[0] += jumps[0], east.column[1] += jumps[1];
  if (__builtin_expect(lost, 0)) north.cross(s.covariance, errors), east.cross(s.covariance, errors);
  north.correct(errors, used);
  east.without(north.column), east.correct(errors, used);
  lower(s.covariance, north.column, east.column);
  s.shown_position = seen ? root(worst) : s.shown_position;

  F across = larger(r.hdop * r.hdop, all(1e-6f)), down = larger(r.vdop * r.vdop, all(1e-6f));
  F stated = r.speed * r.speed / (across + down);
  F variance[3] = {0.5f * across * stated, 0.5f * across * stated, down * stated};
  F fx = -late * s.force.x, fy = -late * s.force.y, fz = -late * s.force.z;
  constexpr int A = ACCELEROMETER;
  Scalar<SPEED, TURN + 1, TURN + 2, A, A + 1, A + 2> ahead = {
      r.velocity.x - then.velocity.x, variance[0], {fz, -fy, late * d.forward.x, late * d.right.x, late * d.down.x}};
  Scalar<SPEED + 1, TURN, TURN + 2, A, A + 1, A + 2> aside = {
      r.velocity.y - then.velocity.y, variance[1], {-fz, fx, late * d.forward.y, late * d.right.y, late * d.down.y}};
  Scalar<SPEED + 2, TURN, TURN + 1, A, A + 1, A + 2> below = {
      r.velocity.z - then.velocity.z, variance[2], {fy, -fx, late * d.forward.z, late * d.right.z, late * d.down.z}};
  measure(s, errors, ahead, aside, below, s.shown_velocity, p.gate);
}

template <int AXIS>
INLINE auto field_along(const State& s, F read, F bias, Vec3 axis, float variance) {
  Vec3 turn = cross(axis, s.earth);
  return Scalar<BIAS + AXIS, TURN, TURN + 1, TURN + 2, EARTH, EARTH + 1, EARTH + 2>{
      read - dot(axis, s.earth) - bias, all(variance), {turn.x, turn.y, turn.z, axis.x, axis.y, axis.z}};
}

INLINE void by_height(State& s, const Readings& r, const Parameters& p, F* errors) {
  Used<Scalar<PLACE + 2>> height{{-r.height - s.position.z - s.low.z, all(p.height_std * p.height_std), {}}, {}};
  F worst = height.cross(s.covariance, errors);
  I seen = finite(height.scalar.innovation);
  height.correct(errors, seen & (worst <= p.gate * p.gate));
  lower(s.covariance, height.column);
  s.shown_height = seen ? root(worst) : s.shown_height;
}

INLINE void by_field(State& s, const Readings& r, const Rotation& d, const Parameters& p, F* errors) {
  float variance = p.field_std * p.field_std;
  measure(s, errors, field_along<0>(s, r.field.x, s.field_bias.x, d.forward, variance),
          field_along<1>(s, r.field.y, s.field_bias.y, d.right, variance),
          field_along<2>(s, r.field.z, s.field_bias.z, d.down, variance), s.shown_field, p.gate);
}

INLINE void inject(State& s, const F* e, int tick) {
  Vec3 place = {e[0], e[1], e[2]}, speed = {e[3], e[4], e[5]}, turn = {e[6], e[7], e[8]};
  add(s.position, s.low, s.low + place);
  for (int age = 1; age <= LATE; age++) {
    Past& then = s.past[(tick + 1 - age + LATE) % LATE];
    then.low = then.low + (place - speed * (float(age) * DT)), then.velocity = then.velocity + speed;
  }
  s.velocity = s.velocity + speed;
  s.attitude = normalised(small(turn * 0.5f) * s.attitude);
  s.gyroscope_bias = s.gyroscope_bias + Vec3{e[9], e[10], e[11]};
  s.accelerometer_bias = s.accelerometer_bias + Vec3{e[12], e[13], e[14]};
  s.earth = s.earth + Vec3{e[15], e[16], e[17]}, s.field_bias = s.field_bias + Vec3{e[18], e[19], e[20]};
}

void step(Block& block, const Parameters& p, int tick) {
  State& s = block.state;
  const Readings& r = block.readings;
  s.past[tick % LATE] = {s.position, s.low, s.velocity};
  Rotation d = predict(s, r, p);
  F errors[SIZE] = {};
  if ((tick + 1) % FIX_TICKS == 0) by_fix(s, r, d, p, s.past[(tick + 1) % LATE], errors);
  by_height(s, r, p, errors);
  if ((tick + 1) % FIELD_TICKS == 0) by_field(s, r, d, p, errors);
  inject(s, errors, tick);
}

void fly(Block* blocks, size_t count, const Parameters& p, int tick, int ticks) {
  // The ticks of one tile before the next tile, since worlds do not meet; within it all vehicles before the next tick.
  for (size_t first = 0; first < count; first += TILE)
    for (int t = tick; t < tick + ticks; t++)
      for (size_t b = first; b < first + TILE && b < count; b++) step(blocks[b], p, t);
}

// ---- what bound.py asks for

double seconds_of(clockid_t clock) {
  timespec now;
  clock_gettime(clock, &now);
  return double(now.tv_sec) + 1e-9 * double(now.tv_nsec);
}

float& number(std::vector<Block>& blocks, size_t k, int vehicle) {
  return reinterpret_cast<float*>(&blocks[size_t(vehicle / LANES)])[k * LANES + size_t(vehicle % LANES)];
}

bool read(Parameters& p, std::vector<Block>& blocks, int vehicles) {
  for (float* value = &p.gyroscope_noise; value <= &p.gravity; value++)
    if (std::scanf("%f", value) != 1) return false;
  for (size_t k = 0; k < sizeof(Block) / sizeof(F); k++)
    for (int i = 0; i < vehicles; i++)
      if (std::scanf("%f", &number(blocks, k, i)) != 1) return false;
  return true;
}

constexpr size_t FIRST = offsetof(Block, state) / sizeof(F), END = sizeof(Block) / sizeof(F);

int run(std::vector<Block>& blocks, const Parameters& p, int vehicles, int ticks, int repeats, int threads) {
  for (int repeat = -1; repeat < repeats; repeat++) {  // the first one warms up
    double wall = seconds_of(CLOCK_MONOTONIC), cpu = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
    std::vector<std::thread> workers;
    for (int k = 0; k < threads; k++) {
      size_t from = blocks.size() * size_t(k) / size_t(threads), to = blocks.size() * size_t(k + 1) / size_t(threads);
      workers.emplace_back(fly, &blocks[from], to - from, std::cref(p), (repeat + 1) * ticks, ticks);
    }
    for (std::thread& worker : workers) worker.join();
    wall = seconds_of(CLOCK_MONOTONIC) - wall, cpu = seconds_of(CLOCK_PROCESS_CPUTIME_ID) - cpu;
    int finite = 0;
    for (int i = 0; i < vehicles; i++) {
      bool whole = true;
      for (size_t k = FIRST; k < END; k++) whole &= std::isfinite(number(blocks, k, i));
      finite += whole;
    }
    if (repeat >= 0) std::printf("%.9g %.9g %d\n", wall, cpu, finite);
  }
  return 0;
}

int check(std::vector<Block>& blocks, const Parameters& p, int vehicles, int ticks) {
  fly(blocks.data(), blocks.size(), p, 0, ticks);
  for (size_t k = FIRST; k < END; k++) {
    for (int i = 0; i < vehicles; i++) std::printf("%.9g ", number(blocks, k, i));
    std::printf("\n");
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  std::string mode = argc > 1 ? argv[1] : "";
  bool runs = mode == "run" && argc == 6, checks = mode == "check" && argc == 4;
  if (!runs && !checks) {
    std::fprintf(stderr, "usage: filter_bound run VEHICLES TICKS REPEATS THREADS | check VEHICLES TICKS\n");
    return 2;
  }
  int vehicles = std::atoi(argv[2]), ticks = std::atoi(argv[3]);
  std::vector<Block> blocks(size_t((vehicles + LANES - 1) / LANES));
  Parameters p;
  if (!read(p, blocks, vehicles)) return 1;
  return checks ? check(blocks, p, vehicles, ticks)
                : run(blocks, p, vehicles, ticks, std::atoi(argv[4]), std::atoi(argv[5]));
}
