#pragma once

/// Registers of the panel kernels. Included by panel_tile.h only.

#include <cstdint>

#if defined(__AVX2__)
#include <immintrin.h>
#endif

namespace bundle::BUNDLE_ISA {
namespace {

constexpr int kLanes = BUNDLE_LANES;
using Vector = double __attribute__((vector_size(8 * kLanes)));

inline int Least(int a, int b) { return a < b ? a : b; }

inline Vector Load(const double* from) {
  Vector v;
  __builtin_memcpy(&v, from, sizeof v);
  return v;
}

inline void Store(const Vector& v, double* to) { __builtin_memcpy(to, &v, sizeof v); }

/// The first `count` lanes, below kLanes; the others are 0.
inline Vector LoadFirst(const double* from, int count) {
#if defined(__AVX512F__)
  return _mm512_maskz_loadu_pd(static_cast<__mmask8>((1U << count) - 1), from);
#elif defined(__AVX2__)
  const __m256i mask =
      _mm256_cmpgt_epi64(_mm256_set1_epi64x(count), _mm256_setr_epi64x(0, 1, 2, 3));
  return _mm256_maskload_pd(from, mask);
#else
  Vector v = {};
  for (int i = 0; i < count; ++i) v[i] = from[i];
  return v;
#endif
}

inline void StoreFirst(const Vector& v, int count, double* to) {
#if defined(__AVX512F__)
  _mm512_mask_storeu_pd(to, static_cast<__mmask8>((1U << count) - 1), v);
#elif defined(__AVX2__)
  const __m256i mask =
      _mm256_cmpgt_epi64(_mm256_set1_epi64x(count), _mm256_setr_epi64x(0, 1, 2, 3));
  _mm256_maskstore_pd(to, mask, v);
#else
  for (int i = 0; i < count; ++i) to[i] = v[i];
#endif
}

inline Vector Broadcast(double x) { return x - Vector{}; }

/// sum - a b, rounded once where the instruction set can. Left to the compiler, some tiles are
/// fused and others are not (GCC 14), and rows get other bits in another tile.
inline Vector SubtractProduct(const Vector& sum, const Vector& a, const Vector& b) {
#if defined(__AVX512F__)
  return _mm512_fnmadd_pd(a, b, sum);
#elif defined(__FMA__)
  return _mm256_fnmadd_pd(a, b, sum);
#else
  return sum - a * b;
#endif
}

inline double SumOfLanes(const Vector& v) {
  double half[kLanes / 2];
  for (int i = 0; i < kLanes / 2; ++i) half[i] = v[i] + v[i + kLanes / 2];
  for (int size = kLanes / 4; size > 0; size /= 2) {
    for (int i = 0; i < size; ++i) half[i] += half[i + size];
  }
  return half[0];
}

}  // namespace
}  // namespace bundle::BUNDLE_ISA
