#include "core/checking/spot_check.h"

/// A spot check of the linearisation. At a sample of observations, each column of the claimed
/// Jacobian is compared with differences of the residual. In the iterations of a solve, a column
/// that is far too small looks like bad scaling (WatchConvergence); this check distinguishes
/// wrong columns from bad scaling.
///
/// Along the axis of one number x_j, with D(h) = (r(x + h e_j) - r(x - h e_j)) / 2h,
///
///   R = D(h/2) + (D(h/2) - D(h)) / 3 = dr/dx_j + O(h^4),     u = ||D(h/2) - D(h)||,
///
/// where u, of order h^2, is far above the error of R if r is smooth at the scale of h. If r is not
/// smooth (across a fold, a seam or the camera's plane), u has the size of R. Rounding adds n / h
/// to u. Here n = eps (||r|| + sum_k |x_k| ||J_k||) is the possible effect of the last digits of x
/// and r. A step is *conclusive* if u is below a hundredth of ||R||. The column J_j then agrees
/// with it if
///
///   ||J_j - R|| < 1e-3 max(||J_j||, ||R||) + 4 u.
///
/// h moves the residual by a given part of a pixel, computed from the largest claimed column of j's
/// kind (rotation, translation, point, twist, or the one parameter). For true columns, the residual
/// is nearly linear at this scale, for coordinates of 1e-9 as well as 1e9. False columns, 1000
/// times too large or too small, are still detected at one of four such scales. If no column moves
/// the residual, the size of the moved variable bounds h. A feature that is narrower than h may
/// look smooth, for instance near the pole of a panorama or at a camera's centre. So
///
/// - any conclusive step that agrees acquits the observation's column,
/// - two conclusive steps, 100 times apart or more, that agree and are not J_j convict it,
/// - everything else leaves it undecided,
///
/// and a column is reported if it is convicted in at least four, and a quarter, of the decided
/// observations of a camera model. At least a tenth of the tested observations must be decided. A
/// false report would need a residual that misleads at every scale in many observations. `bundle
/// check` detects the remaining cases: columns that are wrong in a few observations or by less than
/// one in a thousand, and columns that should be zero and are not, because a residual that lost its
/// last digit does not move either.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <iomanip>
#include <limits>
#include <map>
#include <sstream>
#include <utility>

namespace bundle {
namespace {

// Change of the residual by a step, in pixels; the first value decides nearly all cases.
constexpr double kMoves[] = {1e-2, 1e-4, 1e-6, 1};
constexpr double kStepCap = 0.1;  ///< maximum step, relative to the size of the moved variable
constexpr double kConclusive = 0.01;
constexpr double kTolerance = 1e-3;
constexpr double kSafety = 4;
constexpr double kSameDifferences = 0.02;

constexpr int kFewestConvictions = 4;
constexpr double kConvictedShare = 0.25;
constexpr double kDecidedShare = 0.1;
// The factor is reported if nine in ten convictions agree with it within a hundredth.
constexpr double kSameFactor = 0.01;
constexpr double kFactorShare = 0.9;

struct Pixels {
  double x, y;
};

Pixels operator-(Pixels a, Pixels b) { return {a.x - b.x, a.y - b.y}; }
Pixels operator*(double a, Pixels b) { return {a * b.x, a * b.y}; }
double Dot(Pixels a, Pixels b) { return a.x * b.x + a.y * b.y; }
double Norm(Pixels a) { return std::sqrt(Dot(a, a)); }

/// Columns whose steps have the same scale.
struct Kind {
  const char* name;
  int first, size;
};

std::vector<Kind> KindsOf(const CameraModel& model) {
  std::vector<Kind> kinds = {{"rotation", 0, 3}, {"translation", 3, 3}};
  for (int j = 0; j < model.num_params; ++j) {
    kinds.push_back({model.params[j].name, kPoseSize + j, 1});
  }
  const int point = kPoseSize + model.num_params, twist = point + 3;
  kinds.push_back({"point", point, 3});
  kinds.push_back({"twist rotation", twist, 3});  // no column of a global shutter is free
  kinds.push_back({"twist translation", twist + 3, 3});
  return kinds;
}

enum class Verdict { kUndecided, kAgrees, kConvicted };

struct Comparison {
  Verdict verdict = Verdict::kUndecided;
  double factor = 0;  ///< factor of the claimed column that explains the differences best
  double error = 0;   ///< ||J_j - R|| / ||R||
  bool is_multiple = false;
};

/// Checks one observation, one column after the other.
class Differences {
 public:
  /// `noise`: rounding errors of the residual, pixels.
  Differences(const ObservationAtPoint& at, const ClaimedDerivatives& derivatives, double noise)
      : at_(at), derivatives_(derivatives), noise_(noise) {
    std::copy_n(at.x, at.size(), x_);
  }

  /// `claimed`: J_j; `largest`: the largest claimed column of its kind
  Comparison Compare(int j, Pixels claimed, double largest) {
    Comparison result;
    Pixels convicting = {0, 0};
    bool suspicious = false;
    for (const double move : kMoves) {
      Pixels found;
      double doubt;
      if (!Differentiate(j, StepFor(j, largest, move), &found, &doubt)) continue;
      const double size = Norm(found), error = Norm(claimed - found);
      if (size == 0 && error == 0) return {Verdict::kAgrees};
      if (!(size > 0 && doubt < kConclusive * size)) continue;
      if (error < kTolerance * std::max(Norm(claimed), size) + kSafety * doubt) {
        return {Verdict::kAgrees};
      }
      if (suspicious && Norm(found - convicting) < kSameDifferences * size) {
        result.verdict = Verdict::kConvicted;
        result.factor = Dot(claimed, found) / (size * size);
        result.error = error / size;
        result.is_multiple = Norm(claimed - result.factor * found) <= kSameFactor * Norm(claimed);
      }
      convicting = found;
      suspicious = true;
    }
    return result;
  }

 private:
  double StepFor(int j, double largest, double move) const {
    const double cap = kStepCap * move * SizeOf(j);
    return largest > 0 ? std::min(move / largest, cap) : cap;
  }

  /// The scale of x_j: one radian, the typical distance, or the parameter itself.
  double SizeOf(int j) const {
    const int turn = at_.first_of_twist();
    if (j < 3 || (j >= turn && j < turn + 3)) return 1;
    if (j >= kPoseSize && j < at_.first_of_point()) return std::max(std::abs(at_.x[j]), 1.0);
    const double *t = at_.x + 3, *point = at_.x + at_.first_of_point();
    const double size =
        std::max(std::hypot(t[0], t[1], t[2]), std::hypot(point[0], point[1], point[2]));
    return size > 0 ? size : 1;
  }

  /// Computes R and u; false without a value.
  bool Differentiate(int j, double h, Pixels* derivative, double* doubt) {
    Pixels coarse, fine;
    if (!Central(j, h, &coarse) || !Central(j, h / 2, &fine)) return false;
    const Pixels change = fine - coarse;
    *derivative = fine - (-1.0 / 3) * change;
    *doubt = Norm(change) + noise_ / h;
    return std::isfinite(Norm(*derivative)) && std::isfinite(*doubt);
  }

  bool Central(int j, double h, Pixels* derivative) {
    const double before = at_.x[j], above = before + h, below = before - h;
    double plus[2], minus[2];
    x_[j] = above;
    bool valid = derivatives_(at_.observation, x_, plus, nullptr);
    x_[j] = below;
    valid = valid && derivatives_(at_.observation, x_, minus, nullptr);
    x_[j] = before;
    if (!valid || !(above > below)) return false;
    // The difference of these two has no rounding error, unlike 2 h.
    *derivative = 1 / (above - below) * Pixels{plus[0] - minus[0], plus[1] - minus[1]};
    return true;
  }

  const ObservationAtPoint& at_;
  const ClaimedDerivatives& derivatives_;
  const double noise_;
  double x_[ObservationAtPoint::kMaxSize];
};

/// Results for one column over the observations of one camera model.
struct Tally {
  int tried = 0;
  int agrees = 0;
  std::vector<Comparison> convictions;

  int decided() const { return agrees + static_cast<int>(convictions.size()); }
  double share() const { return static_cast<double>(convictions.size()) / decided(); }
  bool is_wrong() const {
    const auto count = static_cast<int>(convictions.size());
    return count >= kFewestConvictions && count >= kConvictedShare * decided() &&
           decided() >= kDecidedShare * tried;
  }
};

using Tallies = std::array<Tally, ObservationAtPoint::kMaxSize>;

/// Effect of rounding each x_j and the residual to their last digits.
double RoundingErrors(const ObservationAtPoint& at, const double* residual,
                      const double* jacobian) {
  const int size = at.size();
  double sum = std::hypot(residual[0], residual[1]);
  for (int j = 0; j < size; ++j) {
    sum += std::abs(at.x[j]) * std::hypot(jacobian[j], jacobian[size + j]);
  }
  return std::numeric_limits<double>::epsilon() * sum;
}

void CompareColumns(const ObservationAtPoint& at, const ClaimedDerivatives& derivatives,
                    Tallies* tallies) {
  double residual[2], jacobian[2 * ObservationAtPoint::kMaxSize];
  if (!derivatives(at.observation, at.x, residual, jacobian)) return;
  const int size = at.size();
  Differences differences(at, derivatives, RoundingErrors(at, residual, jacobian));
  for (const Kind& kind : KindsOf(*at.model)) {
    if (kind.first >= size) continue;
    double largest = 0;
    for (int j = kind.first; j < kind.first + kind.size; ++j) {
      largest = std::max(largest, Norm({jacobian[j], jacobian[size + j]}));
    }
    if (!std::isfinite(largest)) continue;
    for (int j = kind.first; j < kind.first + kind.size; ++j) {
      if (!(at.free >> j & 1u)) continue;
      Tally& tally = (*tallies)[j];
      ++tally.tried;
      const Comparison found = differences.Compare(j, {jacobian[j], jacobian[size + j]}, largest);
      if (found.verdict == Verdict::kAgrees) ++tally.agrees;
      if (found.verdict == Verdict::kConvicted) tally.convictions.push_back(found);
    }
  }
}

template <typename Field>
double Median(const std::vector<Comparison>& comparisons, Field field) {
  std::vector<double> values;
  for (const Comparison& comparison : comparisons) values.push_back(comparison.*field);
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Error of the columns, as part of a message.
std::string Deviation(const std::vector<Comparison>& convictions) {
  const double factor = Median(convictions, &Comparison::factor);
  const auto alike =
      std::count_if(convictions.begin(), convictions.end(), [&](const Comparison& comparison) {
        return comparison.is_multiple &&
               std::abs(comparison.factor - factor) <= kSameFactor * std::abs(factor);
      });
  std::ostringstream text;
  if (static_cast<double>(alike) >= kFactorShare * static_cast<double>(convictions.size())) {
    text << std::setprecision(4) << factor + 0.0 << " times the finite differences of the residual";
  } else {
    text << std::setprecision(3) << "wrong by " << 100 * Median(convictions, &Comparison::error)
         << " %, compared with finite differences of the residual";
  }
  return text.str();
}

/// The wrong columns of one kind.
struct WrongKind {
  std::string name;
  int observations = 0, decided = 0;  ///< counts for the column that is convicted most often
  std::vector<Comparison> convictions;

  double share() const { return static_cast<double>(observations) / decided; }
};

/// "rotation x, z"
WrongKind FindWrong(const Kind& kind, const Tallies& tallies) {
  WrongKind wrong;
  for (int k = 0; k < kind.size; ++k) {
    const Tally& tally = tallies[kind.first + k];
    if (!tally.is_wrong()) continue;
    wrong.name += wrong.name.empty() ? kind.name : ",";
    if (kind.size > 1) wrong.name += std::string(" ") + "xyz"[k];
    wrong.convictions.insert(wrong.convictions.end(), tally.convictions.begin(),
                             tally.convictions.end());
    if (wrong.decided == 0 || tally.share() > wrong.share()) {
      wrong.observations = static_cast<int>(tally.convictions.size());
      wrong.decided = tally.decided();
    }
  }
  return wrong;
}

std::string Describe(const CameraModel& model, const Tallies& tallies) {
  std::vector<WrongKind> wrong;
  for (const Kind& kind : KindsOf(model)) {
    WrongKind found = FindWrong(kind, tallies);
    if (found.decided > 0) wrong.push_back(std::move(found));
  }
  if (wrong.empty()) return "";
  const auto worst = std::max_element(
      wrong.begin(), wrong.end(),
      [](const WrongKind& a, const WrongKind& b) { return a.share() < b.share(); });
  std::ostringstream text;
  text << "A Jacobian may be wrong: in " << worst->observations << " of " << worst->decided
       << " observations sampled at the end, the derivatives by " << worst->name << " of "
       << model.name << " cameras are " << Deviation(worst->convictions);
  std::string others;
  for (const WrongKind& kind : wrong) {
    if (&kind != &*worst)
      others += (others.empty() ? "; also wrong are those by " : "; ") + kind.name;
  }
  text << others << "; test it with `bundle check`.";
  return text.str();
}

}  // namespace

std::string SpotCheck(const std::vector<ObservationAtPoint>& sample,
                      const ClaimedDerivatives& derivatives) {
  std::map<std::string, std::pair<const CameraModel*, Tallies>>
      models;  // sorted by name, to be repeatable
  for (const ObservationAtPoint& at : sample) {
    auto& [model, tallies] = models[at.model->name];
    model = at.model;
    CompareColumns(at, derivatives, &tallies);
  }
  for (const auto& [name, entry] : models) {
    std::string found = Describe(*entry.first, entry.second);
    if (!found.empty()) return found;
  }
  return "";
}

}  // namespace bundle
