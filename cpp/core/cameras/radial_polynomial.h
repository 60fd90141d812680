#pragma once

/// Even polynomial radial distortion, of any number n of coefficients.
///
/// With s = u^2 + v^2 and the factor d(s) = 1 + k1 s + ... + kn s^n
///
///   u_d = d u,   v_d = d v.
///
/// From ds/du = 2u, ds/dv = 2v and d' = k1 + 2 k2 s + ... + n kn s^(n-1)
///
///   du_d/du = d + 2 d' u^2,   du_d/dv = dv_d/du = 2 d' u v,   dv_d/dv = d + 2 d' v^2,
///   du_d/dkj = s^j u,   dv_d/dkj = s^j v.

namespace bundle {

/// d(s) and d'(s), by Horner's rule.
template <int n, typename T>
struct EvenPolynomial {
  T value = 1, slope = 0;

  EvenPolynomial(const T* k, T s) {
    if constexpr (n > 0) {
      value = k[n - 1];
      for (int j = n - 1; j >= 0; --j) {
        slope = value + s * slope;
        value = (j > 0 ? k[j - 1] : T(1)) + s * value;
      }
    }
  }
};

/// A distortion as lens.h wants it.
template <int n>
struct RadialPolynomial {
  static constexpr int kNumParams = n;
  static constexpr bool kIsPolynomial = true;

  template <typename T>
  static bool Distort(const T* k, T u, T v, T* uv_d, T* d_uv, T* d_k) {
    const T s = u * u + v * v;
    const EvenPolynomial<n, T> d(k, s);
    uv_d[0] = d.value * u;
    uv_d[1] = d.value * v;
    if (d_uv != nullptr) {
      const T slope = 2 * d.slope;
      d_uv[0] = d.value + slope * u * u;
      d_uv[1] = d_uv[2] = slope * u * v;
      d_uv[3] = d.value + slope * v * v;
    }
    if (d_k != nullptr) {
      T power = 1;
      for (int j = 0; j < n; ++j) {
        power *= s;
        d_k[j] = power * u;
        d_k[n + j] = power * v;
      }
    }
    return true;
  }
};

/// No distortion at all.
template <>
struct RadialPolynomial<0> {
  static constexpr int kNumParams = 0;
  static constexpr bool kIsPolynomial = true;

  template <typename T>
  static bool Distort(const T*, T u, T v, T* uv_d, T* d_uv, T*) {
    uv_d[0] = u;
    uv_d[1] = v;
    if (d_uv != nullptr) d_uv[0] = d_uv[3] = 1, d_uv[1] = d_uv[2] = 0;
    return true;
  }
};

}  // namespace bundle
