/// Part of edge_kernels.h: passes for one instruction set, with a lane per edge (parallel/pack.h).
///
/// The formulae are those of edge_kernel.h, relative_pose.h and geometry. Their coefficients are
/// entire functions of the squared angle s <= pi^2 up to half a turn, so that series without
/// branches serve all lanes: with A = sum (-s)^n / (2n + 1)!, B = sum (-s)^n / (2n + 2)!,
///
///   D = (1 - A / (2 B)) / s = G / (2 B),      G = (2 B - A) / s = sum (-s)^n (2n + 2) / (2n + 4)!.
///
/// Sixteen terms are sufficient: s^16 / 33! is below 1e-20 at pi^2. At the end of its range B is
/// 2 / pi^2, and no sum loses more than a digit.
///
/// The cosine and the sine of an angle have series of the rest r = angle - q pi / 2, at most pi /
/// 4, with pi / 2 in two parts: q times the first one is exact (Cody and Waite, Software Manual for
/// the Elementary Functions, 1980).

#include "core/parallel/pack.h"
#include "core/pose_graph/edge_kernel.h"
#include "core/pose_graph/kernels/edge_kernels.h"

extern "C" double atan2(double, double) noexcept;
extern "C" double cos(double) noexcept;
extern "C" double sin(double) noexcept;
extern "C" double remainder(double, double) noexcept;

namespace bundle::BUNDLE_ISA {

constexpr int kTerms = 16;

/// asin(y) / y = sum of[n] y^2n = sum binomial(2n, n) / (2n + 1) (y / 2)^2n
struct ArcsineTerms {
  double of[kTerms];
  constexpr ArcsineTerms() : of() {
    double binomial = 1;  // divided by 4^n
    for (int n = 0; n < kTerms; ++n) {
      if (n > 0) binomial *= (2 * n - 1) / (2.0 * n);
      of[n] = binomial / (2 * n + 1);
    }
  }
};
constexpr ArcsineTerms kArcsine;

/// sum (-s)^n weight(n) / (2n + k)!
template <typename Weight>
inline Pack Series(const Pack& s, int k, const Weight& weight) {
  Pack sum = 0.0;
  for (int n = kTerms - 1; n >= 0; --n) {
    sum = weight(n) * kInverseFactorials.of[2 * n + k] - s * sum;
  }
  return sum;
}

inline Pack Series(const Pack& s, int k) {
  return Series(s, k, [](int) { return 1.0; });
}

struct Coefficients {
  Pack a, b, c;
};

inline Coefficients ExpCoefficients(const Pack& s) {
  return {Series(s, 1), Series(s, 2), Series(s, 3)};
}

inline void MotionCoefficients(const Pack& s, Pack out[3]) {
  for (int k = 3; k <= 5; ++k) out[k - 3] = Series(s, k);
}

inline Pack LogCoefficient(const Pack& s) {
  return 0.5 * Series(s, 4, [](int n) { return 2.0 * n + 2; }) / Series(s, 2);
}

inline Pack SignOf(const Pack& x) { return Select(x >= 0.0, 1.0, -1.0); }

/// 2 asin(y) / y of a sine y = sin(a / 2): a series up to |y| = 0.2, beyond it lane by lane.
inline Pack LogFactor(const Pack& sine, const Pack& cosine) {
  constexpr double kLargest = 0.04;
  const Pack y = sine * sine;
  Pack sum = 0.0;
  for (int n = kTerms - 1; n >= 0; --n) sum = kArcsine.of[n] + y * sum;
  Pack factor = 2 * sum;
  const Mask is_small = y <= kLargest;
  if (All(is_small)) return factor;
  for (int i = 0; i < kLanes; ++i) {
    if (is_small.bits[i] == 0) factor.v[i] = 2 * ::atan2(sine.v[i], cosine.v[i]) / sine.v[i];
  }
  return factor;
}

inline Pack WrapAngle(const Pack& angle) {
  constexpr double kPi = 3.141592653589793;
  const Mask is_inside = (angle <= kPi) & (angle >= -kPi);
  if (All(is_inside)) return angle;
  Pack wrapped = angle;
  for (int i = 0; i < kLanes; ++i) {
    if (is_inside.bits[i] == 0) wrapped.v[i] = ::remainder(angle.v[i], 2 * kPi);
  }
  return wrapped;
}

inline void CosineAndSine(const Pack& angle, Pack* cosine, Pack* sine) {
  constexpr double kFirstPart = 0x1.921fb544p+0, kSecondPart = 6.077100506506192e-11;
  constexpr double kToWhole = 0x1.8p+52;  // added to a number, it rounds it to a whole one
  constexpr double kLargest = 1e6;
  const Pack shifted = angle * 0.6366197723675814 + kToWhole, q = shifted - kToWhole;
  const Pack r = (angle - q * kFirstPart) - q * kSecondPart;
  const Pack c = Series(r * r, 0), s = r * Series(r * r, 1);
  const auto quarter = reinterpret_cast<Pack::Bits>(shifted.v) & 3;
  const Mask is_odd{(quarter & 1) != 0};
  *cosine = Select(is_odd, s, c);
  *sine = Select(is_odd, c, s);
  *cosine = Select(Mask{((quarter + 1) & 2) != 0}, -*cosine, *cosine);
  *sine = Select(Mask{(quarter & 2) != 0}, -*sine, *sine);
  const Mask is_inside = (angle <= kLargest) & (angle >= -kLargest);
  if (All(is_inside)) return;
  for (int i = 0; i < kLanes; ++i) {
    if (is_inside.bits[i] != 0) continue;
    cosine->v[i] = ::cos(angle.v[i]);
    sine->v[i] = ::sin(angle.v[i]);
  }
}

namespace {

template <typename Group>
constexpr int kRoot = RootSize(Group::kTangent);

/// Operands of kLanes edges, the last one repeated if there are fewer.
template <typename Group>
struct EdgeLanes {
  Pack x_i[Group::kRecord], x_j[Group::kRecord], z[Group::kRecord], root[kRoot<Group>];

  EdgeLanes(const EdgeArrays& arrays, const int64_t* edges, int64_t count) {
    const double *at_i[kLanes], *at_j[kLanes], *at_z[kLanes], *at_root[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) {
      const int64_t e = edges[lane < count ? lane : count - 1];
      at_i[lane] = arrays.poses + int64_t{arrays.ends[2 * e]} * Group::kRecord;
      at_j[lane] = arrays.poses + int64_t{arrays.ends[2 * e + 1]} * Group::kRecord;
      at_z[lane] = arrays.measurements + e * Group::kRecord;
      at_root[lane] = arrays.roots + e * kRoot<Group>;
    }
    GatherRecords(at_i, Group::kRecord, x_i);
    GatherRecords(at_j, Group::kRecord, x_j);
    GatherRecords(at_z, Group::kRecord, z);
    GatherRecords(at_root, kRoot<Group>, root);
  }
};

template <typename Group>
void Linearize(const EdgeArrays& arrays, const int64_t* edges, int64_t count, double* out) {
  constexpr int kNumbers = EdgeTerms<Group>::kNumbers;
  double spare[kNumbers];
  for (int64_t first = 0; first < count; first += kLanes) {
    const EdgeLanes<Group> lanes(arrays, edges + first, count - first);
    Pack terms[kNumbers];
    for (int k = EdgeTerms<Group>::kChi2 + 1; k < kNumbers; ++k) terms[k] = 0.0;
    LinearizeEdge<Group>(arrays.error, lanes.x_i, lanes.x_j, lanes.z, lanes.root, terms);
    double* records[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) {
      records[lane] = first + lane < count ? out + (first + lane) * kNumbers : spare;
    }
    for (int k = 0; k < kNumbers; k += 4) {
      const Pack* const four[4] = {terms + k, terms + k + 1, terms + k + 2, terms + k + 3};
      ScatterRecords(four, records, k);
    }
  }
}

template <typename Group>
void Chi2(const EdgeArrays& arrays, const int64_t* edges, int64_t count, double* chi2) {
  for (int64_t first = 0; first < count; first += kLanes) {
    const EdgeLanes<Group> lanes(arrays, edges + first, count - first);
    Pack residual[Group::kTangent], *const none = nullptr;
    EvaluateWhitened<Group>(arrays.error, lanes.x_i, lanes.x_j, lanes.z, lanes.root, residual, none,
                            none);
    Pack sum = 0.0;
    for (int r = 0; r < Group::kTangent; ++r) sum += residual[r] * residual[r];
    for (int lane = 0; lane < kLanes && first + lane < count; ++lane) {
      chi2[first + lane] = sum.v[lane];
    }
  }
}

void PlanarRecords(const double* poses, int64_t count, double* out) {
  double spare[Se2::kRecord];
  for (int64_t first = 0; first < count; first += kLanes) {
    const double* at[kLanes];
    double* records[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) {
      const bool is_last = first + lane >= count;
      at[lane] = poses + (is_last ? count - 1 : first + lane) * Se2::kAmbient;
      records[lane] = is_last ? spare : out + (first + lane) * Se2::kRecord;
    }
    Pack pose[3], cosine, sine;
    const Pack zero = 0.0;
    GatherTriples(at, pose);
    CosineAndSine(pose[2], &cosine, &sine);
    const Pack* const begin[4] = {pose, pose + 1, pose + 2, &cosine};
    const Pack* const end[4] = {&sine, &zero, &zero, &zero};
    ScatterRecords(begin, records, 0);
    ScatterRecords(end, records, 4);
  }
}

void SpatialRecords(const double* poses, int64_t count, double* out) {
  for (int64_t i = 0; i < count; ++i) {
    Se3::Record(poses + i * Se3::kAmbient, out + i * Se3::kRecord);
  }
}

}  // namespace

extern constexpr EdgeKernels<Se2> kPlanarEdgeKernels = {&Linearize<Se2>, &Chi2<Se2>,
                                                        &PlanarRecords};
extern constexpr EdgeKernels<Se3> kSpatialEdgeKernels = {&Linearize<Se3>, &Chi2<Se3>,
                                                         &SpatialRecords};

}  // namespace bundle::BUNDLE_ISA
