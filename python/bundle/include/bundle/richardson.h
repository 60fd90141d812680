#pragma once

/// Derivatives by central differences with Richardson extrapolation, and bounds on their errors.
///
/// With D(h) = (f(h) - f(-h)) / 2h = f' + c2 h^2 + c4 h^4 + ..., halving h and combining removes
/// one power of h^2 after the other:
///
///   T(k, 0) = D(h0 / 2^k),     T(k, m) = T(k, m-1) + (T(k, m-1) - T(k-1, m-1)) / (4^m - 1).
///
/// The difference of T(k, m) to its two parents estimates its error, both truncation and rounding.
/// The entry with the least estimate is used (Ridders, "Accurate computation of F'(x) and
/// F'(x)F''(x)", 1982). Ceres stops its tableau by an absolute threshold and drops the estimate.
/// Here the step shrinks further, by orders of magnitude if necessary (a point close to the camera,
/// a parameter near a singularity), until the estimate of each value is small relative to its own
/// slopes, whatever the other values are. The estimate is returned, so that a comparison can
/// subtract the uncertainty of the reference.
///
/// A bound from one range of steps is valid only if f is smooth on that range. Close to a pole, for
/// instance 1 / (x + d) with steps h far above d, D(h) = 1 / (h^2 - d^2) seems to converge to zero.
/// So settled values are compared with D at steps that are smaller by powers of 64:
///
/// - if they agree up to rounding errors, the bound is kept;
/// - if finer steps settle on another value, that is the derivative;
/// - if they do not settle, the bound grows by the disagreement.
///
/// At a kink at the point itself, D(h) stays smooth. The kink is visible in half the difference of
/// the slopes on both sides, s(h) = |f(h) - 2 f(0) + f(-h)| / 2h, which falls with h for a smooth
/// f. There, any number within s of D is a slope of f, and the bound is at least s.

#include <bundle/resolution.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace bundle {

namespace richardson_internal {

inline constexpr int kRows = 8;           ///< rows of a tableau
inline constexpr int kTableaux = 5;       ///< maximum number of tableaux
inline constexpr double kRestart = 64;    ///< ratio of first steps of consecutive tableaux
inline constexpr double kEnough = 1e-10;  ///< part of the slope that needs no further step
inline constexpr double kNoisy =
    1e-9;  ///< least rounding, over the slope, that longer steps divide
inline constexpr double kTooNoisy = 1e-4;  ///< jumps rather than rounding
inline constexpr double kErrorSafety = 4;  ///< on the estimated error
inline constexpr int kProbes = 4;          ///< number of smaller steps that verify a settled result
inline constexpr double kNoise = 8;        ///< disagreement explained by rounding, in units of it
inline constexpr double kSameSlopes = 0.1;  ///< relative change of s(h) between scales at a kink
inline constexpr int kKinkScales = 3;       ///< number of scales with equal s(h) that prove a kink
inline constexpr double kInfinity = std::numeric_limits<double>::infinity();
inline constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

/// A derivative of each value, and the estimates of its error.
struct Estimate {
  explicit Estimate(int num_values)
      : derivative(num_values),
        uncertainty(num_values, kInfinity),
        spread(num_values, kInfinity),
        curvature(num_values),
        slope(num_values),
        row(num_values, -1),
        order(num_values) {}

  std::vector<double> derivative, uncertainty;
  std::vector<double> spread;     ///< max - min of D(h) over the smaller half of the steps
  std::vector<double> curvature;  ///< |D(h) - derivative| / h^2 of the first step
  std::vector<double> slope;      ///< largest difference to a side at the last step, over the step
  std::vector<int> row, order;    ///< k and m of the derivative T(k, m) in its tableau
};

/// Searches for a kink at step 0, over several scales.
class KinkFinder {
 public:
  explicit KinkFinder(int num_values) : last_(num_values), scales_(num_values), kink_(num_values) {}

  /// `half_jump`: s(h) of value i; `rounding`: the part of it that rounding can explain.
  void Add(int i, double half_jump, double rounding) {
    const bool same =
        half_jump > rounding && std::abs(half_jump - last_[i]) <= kSameSlopes * half_jump;
    scales_[i] = same ? scales_[i] + 1 : 1;
    last_[i] = half_jump;
    if (scales_[i] >= kKinkScales) kink_[i] = std::max(kink_[i], half_jump);
  }

  /// s of the kink, 0 without a kink.
  double kink(int i) const { return kink_[i]; }

 private:
  std::vector<double> last_;
  std::vector<int> scales_;
  std::vector<double> kink_;
};

class Search {
 public:
  Search(const LineFunction& f, int num_values, const double* noise)
      : f_(f),
        n_(num_values),
        noise_(noise, noise + num_values),
        best_(num_values),
        kinks_(num_values),
        disagreement_(num_values),
        center_(num_values),
        plus_(num_values),
        minus_(num_values),
        table_(static_cast<size_t>(kRows) * num_values),
        next_(static_cast<size_t>(kRows) * num_values),
        differences_(static_cast<size_t>(kRows) * num_values) {
    has_center_ = f_(0, center_.data());
  }

  const Estimate& best() const { return best_; }

  /// Fills a tableau from step h on. Replaces current entries by more certain ones, and by entries
  /// that contradict them: then larger steps crossed a discontinuity.
  void Run(double h) {
    const Estimate found = Tableau(h);
    for (int i = 0; i < n_; ++i) {
      if (found.uncertainty[i] < best_.uncertainty[i] || Contradicts(found, i)) {
        best_.derivative[i] = found.derivative[i];
        best_.uncertainty[i] = found.uncertainty[i];
        best_.curvature[i] = found.curvature[i];
        best_.slope[i] = found.slope[i];
      }
    }
  }

  /// True if steps smaller than h would not help, unless Confirm contradicts: errors are small
  /// relative to the value's slope, or equal to the rounding of the values.
  bool Enough(double h) const { return Enough(best_, h); }

  /// Compares the settled values at steps of h with smaller steps, and adds the disagreement to the
  /// bounds.
  void Confirm(double h) {
    const Estimate settled = best_;
    std::vector<double> disagreement(n_);
    for (int probe = 0; probe < kProbes; ++probe) {
      h /= kRestart;
      if (!CentralDifference(h)) continue;
      LookForKinks(h);
      bool is_doubtful = false;
      for (int i = 0; i < n_; ++i) {
        if (IsPlateau(i)) continue;
        const double change = std::abs(next_[i] - settled.derivative[i]);
        const double explained = settled.uncertainty[i] + settled.curvature[i] * h * h;
        if (change <= kErrorSafety * explained + kNoise * noise_[i] / h) continue;
        disagreement[i] = std::max(disagreement[i], change);
        is_doubtful = true;
      }
      if (is_doubtful) Run(h);
    }
    for (int i = 0; i < n_; ++i) {
      if (best_.derivative[i] != settled.derivative[i]) continue;
      disagreement_[i] = disagreement[i];
      best_.uncertainty[i] = std::max(best_.uncertainty[i], disagreement[i]);
    }
  }

  /// Divides rounding errors, if they decide even at the first step, by a longer one. Its values
  /// are to agree with those of the shorter steps.
  void Lengthen(double first_step, double longest_step) {
    const auto is_noisy = [&](int i) {
      const double noise = noise_[i] / (first_step * best_.slope[i]);
      return noise > kNoisy && noise < kTooNoisy;
    };
    int first = 0;
    while (first < n_ && !is_noisy(first)) ++first;
    if (first == n_) return;
    const Estimate longer = Tableau(longest_step);
    for (int i = first; i < n_; ++i) {
      const double known = best_.uncertainty[i];
      const double uncertainty = std::max(longer.uncertainty[i], disagreement_[i]);
      const double change = std::abs(longer.derivative[i] - best_.derivative[i]);
      if (!is_noisy(i) || uncertainty >= known || !(change <= known)) continue;
      best_.derivative[i] = longer.derivative[i];
      best_.uncertainty[i] = uncertainty;
    }
  }

  /// At a kink, any slope between those of both sides is valid.
  void AddKinks() {
    for (int i = 0; i < n_; ++i) {
      best_.uncertainty[i] = std::max(best_.uncertainty[i], (1 + kSameSlopes) * kinks_.kink(i));
    }
  }

 private:
  Estimate Tableau(double h) {
    Estimate found(n_);
    double first_step = 0;
    int row = 0;
    for (int k = 0; k < kRows; ++k, h *= 0.5) {
      if (!CentralDifference(h)) {
        row = 0;  // extrapolation from larger steps is invalid now
        continue;
      }
      if (row == 0) {
        first_step = h;
        LookForKinks(h);
      }
      for (int i = 0; i < n_; ++i) {
        differences_[row * n_ + i] = IsPlateau(i) ? kNone : next_[i];
        found.slope[i] = Slope(i, h);
      }
      Extrapolate(row, h, &found);
      std::swap(table_, next_);
      ++row;
      if (row >= 3 && Enough(found, h)) break;
    }
    for (int i = 0; row > 1 && i < n_; ++i) {
      found.spread[i] = Spread(i, row / 2, row);
      const double first = differences_[i];
      if (std::isnan(first)) continue;
      found.curvature[i] = std::abs(first - found.derivative[i]) / (first_step * first_step);
    }
    return found;
  }

  /// Spread of the differences in rows [begin, end); infinite if one of them is NaN because the
  /// value did not change.
  double Spread(int i, int begin, int end) const {
    double lowest = kInfinity, highest = -kInfinity;
    for (int row = begin; row < end; ++row) {
      const double difference = differences_[row * n_ + i];
      if (std::isnan(difference)) return kInfinity;
      lowest = std::min(lowest, difference);
      highest = std::max(highest, difference);
    }
    return highest - lowest;
  }

  bool Enough(const Estimate& estimate, double h) const {
    for (int i = 0; i < n_; ++i) {
      if (estimate.uncertainty[i] > kEnough * estimate.slope[i] + 2 * noise_[i] / h) return false;
    }
    return true;
  }

  /// True if smaller steps converge to another value. Among many differences, some agree by chance.
  bool Contradicts(const Estimate& finer, int i) const {
    const double change = std::abs(finer.derivative[i] - best_.derivative[i]);
    return change > kErrorSafety * finer.spread[i] + finer.uncertainty[i] + best_.uncertainty[i];
  }

  void LookForKinks(double h) {
    if (!has_center_ || h == last_kink_step_) return;
    last_kink_step_ = h;
    for (int i = 0; i < n_; ++i) {
      const double bend = (plus_[i] - center_[i]) + (minus_[i] - center_[i]);
      kinks_.Add(i, std::abs(bend) / (2 * h), kNoise * noise_[i] / h);
    }
  }

  /// True if the value did not change at all: the step is below its resolution, or it is a
  /// constant.
  bool IsPlateau(int i) const {
    return plus_[i] == minus_[i] && (!has_center_ || plus_[i] == center_[i]);
  }

  /// Largest slope to a side of the last central difference.
  double Slope(int i, double h) const {
    if (!has_center_) return std::abs(next_[i]);
    return std::max(std::abs(plus_[i] - center_[i]), std::abs(minus_[i] - center_[i])) / h;
  }

  /// Writes D(h) to the first entries of `next_`.
  bool CentralDifference(double h) {
    if (!f_(h, plus_.data()) || !f_(-h, minus_.data())) return false;
    for (int i = 0; i < n_; ++i) {
      next_[i] = (plus_[i] - minus_[i]) / (2 * h);
      if (!std::isfinite(next_[i])) return false;
    }
    return true;
  }

  void Extrapolate(int row, double h, Estimate* found) {
    double power = 1;
    for (int m = 1; m <= row; ++m) {
      power *= 4;
      for (int i = 0; i < n_; ++i) {
        const double left = next_[(m - 1) * n_ + i];
        const double above = table_[(m - 1) * n_ + i];
        next_[m * n_ + i] = left + (left - above) / (power - 1);
      }
    }
    for (int i = 0; i < n_; ++i) {
      AskNextRow(row, i, h, found);
      for (int m = 1; m <= row; ++m) {
        const double entry = next_[m * n_ + i];
        const double left = next_[(m - 1) * n_ + i], above = table_[(m - 1) * n_ + i];
        const double error =
            kErrorSafety * std::max(std::abs(entry - left), std::abs(entry - above)) +
            noise_[i] / h;
        if (error >= found->uncertainty[i]) continue;
        found->uncertainty[i] = error;
        found->derivative[i] = entry;
        found->row[i] = row;
        found->order[i] = m;
      }
    }
  }

  /// An entry that agrees with both parents by chance does not agree with the one below it.
  void AskNextRow(int row, int i, double h, Estimate* found) const {
    if (row == 0 || found->row[i] != row - 1) return;
    const double change = std::abs(next_[found->order[i] * n_ + i] - found->derivative[i]);
    found->uncertainty[i] = std::max(found->uncertainty[i], change - noise_[i] / h);
  }

  const LineFunction& f_;
  const int n_;
  std::vector<double> noise_;
  Estimate best_;
  KinkFinder kinks_;
  std::vector<double> disagreement_;  ///< deviation of smaller steps
  double last_kink_step_ = 0;
  bool has_center_ = false;
  std::vector<double> center_, plus_, minus_;  ///< f(0), f(h), f(-h)
  std::vector<double> table_, next_;           ///< the last row and the new row, kRows x num_values
  std::vector<double> differences_;  ///< D(h) of each row of a tableau; kNone if f did not change
};

}  // namespace richardson_internal

/// The derivative of each value at step 0 and a bound on its error, which is infinite if no
/// derivative was found. The search begins at `first_step` > 0. `noise` is the size of the rounding
/// errors of each value, and its resolution (bundle/resolution.h). If rounding errors decide, a
/// step of `longest_step` divides them.
inline void RichardsonDerivative(const LineFunction& f, int num_values, double first_step,
                                 const double* noise, double* derivative, double* uncertainty,
                                 double longest_step = 0) {
  richardson_internal::Search search(f, num_values, noise);
  double h = first_step;
  for (int tableau = 0; tableau < richardson_internal::kTableaux;
       ++tableau, h /= richardson_internal::kRestart) {
    search.Run(h);
    if (!search.Enough(h)) continue;
    search.Confirm(h);
    break;
  }
  if (longest_step > first_step) search.Lengthen(first_step, longest_step);
  search.AddKinks();
  std::copy_n(search.best().derivative.begin(), num_values, derivative);
  std::copy_n(search.best().uncertainty.begin(), num_values, uncertainty);
}

}  // namespace bundle
