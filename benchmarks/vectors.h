// Vectors of single-precision numbers for bound.cc and filter_bound.cc: 16 lanes with AVX-512, 8 with AVX2, else 4.

#pragma once

#include <cstdint>
#if defined(__AVX512DQ__) || defined(__AVX2__)
#include <immintrin.h>
#endif

namespace {

#if defined(__AVX512DQ__)
constexpr int LANES = 16;
#elif defined(__AVX2__)
constexpr int LANES = 8;
#else
constexpr int LANES = 4;
#endif
constexpr int BYTES = 4 * LANES;
typedef float F __attribute__((vector_size(BYTES)));
typedef int32_t I __attribute__((vector_size(BYTES)));
typedef uint32_t U __attribute__((vector_size(BYTES)));
#define INLINE inline __attribute__((always_inline))

INLINE F all(float x) { return F{} + x; }
INLINE F as_float(I x) { return (F)x; }

#if defined(__AVX512DQ__) || defined(__AVX2__)
#if defined(__AVX512DQ__)
typedef __m512 R;
#define OF(name) _mm512_##name
#define ESTIMATE(name) _mm512_##name##14_ps
INLINE F nearest(F x) { return (F)_mm512_roundscale_ps((R)x, 8); }
INLINE bool any(I mask) { return _mm512_movepi32_mask((__m512i)mask) != 0; }
#else
typedef __m256 R;
#define OF(name) _mm256_##name
#define ESTIMATE(name) _mm256_##name##_ps
INLINE F nearest(F x) { return (F)_mm256_round_ps((R)x, 8); }
INLINE bool any(I mask) { return _mm256_movemask_ps((R)mask) != 0; }
#endif
INLINE F smaller(F a, F b) { return (F)OF(min_ps)((R)a, (R)b); }
INLINE F larger(F a, F b) { return (F)OF(max_ps)((R)a, (R)b); }
INLINE F root(F x) { return (F)OF(sqrt_ps)((R)x); }
// One Newton step on an estimate of 14 or 12 bits: relative error below 2e-7 or 3e-7, for normal x > 0.
INLINE F inverse_root(F x) {
  F y = (F)ESTIMATE(rsqrt)((R)x);
  return y * (1.5f - 0.5f * x * y * y);
}
INLINE F inverse(F x) {
  F y = (F)ESTIMATE(rcp)((R)x);
  return y * (2.0f - x * y);
}
#else
INLINE F smaller(F a, F b) { return a < b ? a : b; }
INLINE F larger(F a, F b) { return a > b ? a : b; }
INLINE F root(F x) {
  for (int i = 0; i < LANES; i++) x[i] = __builtin_sqrtf(x[i]);
  return x;
}
INLINE F nearest(F x) {
  F magic = all(12582912.0f);
  return (x + magic) - magic;
}
INLINE bool any(I mask) {
  int found = 0;
  for (int i = 0; i < LANES; i++) found |= mask[i];
  return found != 0;
}
INLINE F inverse_root(F x) { return 1.0f / root(x); }
INLINE F inverse(F x) { return 1.0f / x; }
#endif

template <int N>
INLINE U turned(U x) { return (x << N) | (x >> (32 - N)); }
INLINE F clip(F x, float low, float high) { return smaller(larger(x, all(low)), all(high)); }
INLINE F magnitude(F x) { return as_float((I)x & 0x7fffffff); }
INLINE F flipped(F x, I sign) { return as_float((I)x ^ (sign << 31)); }

template <typename... C>
INLINE F horner(F x, double first, C... rest) {
  F result = all(float(first));
  ((result = result * x + float(rest)), ...);
  return result;
}

}  // namespace
