#include "core/model/gauge_hold.h"

/// Fixes the gauge by holding as many pose numbers as there are motions that change no image.
///
/// Let N be a basis of these motions (gauge_count.h) with m columns, and g_j N the derivative of a
/// pose number j by them. Numbers j_1, ..., j_m with independent rows g_j N can be held constant.
/// Among all worlds that are equal up to a motion, one has these numbers at their start values
/// (implicit function theorem), so that the minimum does not change. As G N is regular, no motion
/// remains. This is true for any other constant parameters (a point, an image, a baseline), because
/// N takes them into account.
///
/// Numbers are held one by one. After each number, N becomes an orthonormal basis of the null space
/// of its row. Poses are used in the order of images, each for as many numbers as possible. A pose
/// that moves by less than kShare of the motion of another pose is skipped. A relatively short
/// baseline determines the scale badly, and a baseline that is only noise can change its sign.
/// Sensors are used last; they determine the scale if there is no second frame.
///
/// Numbers of the rotation come first, as long as the pose rotates by at least kTurn times its
/// translation (radians compared with units of the scene). With the rotation held, its translation
/// is equivalent to its centre, for any origin. If a far point is held, rotations about it are
/// translations. Among several numbers, the one that moves most is held. If no other parameter is
/// constant, these are all six of the first pose. The remaining motion scales the world about the
/// first pose's centre. It moves a second pose's translation by t_2 -> t_2 + (s - 1) t_21, with
/// t_21 that of cam2_from_cam1: its largest coordinate is held.

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/dense/decompositions.h"
#include "core/model/gauge_count.h"

namespace bundle {
namespace {

using Eigen::MatrixXd;

constexpr double kShare = 0.01;
constexpr double kTurn = 0.1;
/// Below this motion a number counts as constant, for motions of norm 1.
constexpr double kStill = 1e-9;
/// Numbers whose motions differ by less than this share count as equal, so that rounding does not
/// decide.
constexpr double kEqual = 1e-6;

class GaugeHolder {
 public:
  /// Keeps references: `before` does not change.
  GaugeHolder(const AdjustmentProblem& problem, const FreeParameters& before, FreeParameters* free)
      : motions_(problem, before), basis_(motions_.Basis()), free_(free) {
    left_ = MatrixXd::Identity(basis_.cols(), basis_.cols());
    if (basis_.cols() == 0) return;
    poses_ = motions_.Poses();
    moves_.resize(poses_.size());
    for (const int pose : poses_) num_of_world_ += pose < problem.num_images + problem.num_frames;
  }

  /// Holds numbers of the poses, and returns the remaining motions.
  Eigen::Index Hold() {
    HoldBy(0, num_of_world_);
    HoldBy(num_of_world_, poses_.size());
    return left_.cols();
  }

 private:
  /// A pose number, and its change by the remaining motions.
  struct Number {
    int column = -1;
    double norm = 0;
  };

  double Norm(const MatrixXd& moves, int column) const {
    return (moves.row(column) * left_).norm();
  }

  Number Largest(size_t place, const MatrixXd& moves, int first) const {
    Number largest;
    for (int column = first; column < first + 3; ++column) {
      if ((free_->OfPose(poses_[place]) >> column & 1) == 0) continue;
      const double norm = Norm(moves, column);
      if (norm > largest.norm * (1 + kEqual)) largest = {column, norm};
    }
    return largest;
  }

  /// Changes of poses by the basis, computed on demand: most of them are never needed.
  const FreeMotions::PoseMoves& MovesOf(size_t place) {
    std::optional<FreeMotions::PoseMoves>& moves = moves_[place];
    if (!moves) moves = motions_.MovesOf(poses_[place], basis_);
    return *moves;
  }

  /// Returns the next number of a pose to hold.
  Number Next(size_t place) {
    const FreeMotions::PoseMoves& moves = MovesOf(place);
    const Number turn = Largest(place, moves.chart, 0);
    const Number shift = Largest(place, moves.centered, 3);
    if (turn.norm >= kTurn * shift.norm) return turn;
    const Number in_chart = Largest(place, moves.chart, 3);
    return in_chart.norm > kStill ? Number{in_chart.column, shift.norm} : turn;
  }

  void HoldBy(size_t first, size_t last) {
    for (size_t place = first; place < last && left_.cols() > 0; ++place) {
      Number next = Next(place);
      while (next.norm > kStill && IsLong(next.norm, first, last)) {
        Take(place, next.column);
        if (left_.cols() == 0) return;
        next = Next(place);
      }
    }
  }

  /// True if no pose moves much more than this one.
  bool IsLong(double norm, size_t first, size_t last) {
    if (norm >= kShare * motions_.LongestMove()) return true;
    double most = 0;
    for (size_t place = first; place < last; ++place) most = std::max(most, Next(place).norm);
    return norm >= kShare * most;
  }

  void Take(size_t place, int column) {
    uint8_t& bits = free_->OfPose(poses_[place]);
    bits = static_cast<uint8_t>(bits & ~(1u << column));
    const MatrixXd row = MovesOf(place).chart.row(column) * left_;
    left_ = Multiply(left_, DecomposeSingular(row).vectors.rightCols(left_.cols() - 1));
  }

  const FreeMotions motions_;
  const MatrixXd basis_;
  FreeParameters* const free_;
  std::vector<int> poses_;
  size_t num_of_world_ = 0;  ///< number of poses_ before the sensors
  std::vector<std::optional<FreeMotions::PoseMoves>> moves_;
  MatrixXd left_;  ///< combinations of the basis that are still free
};

}  // namespace

std::string HoldFreeMotions(const AdjustmentProblem& problem, FreeParameters* free) {
  const FreeParameters before = *free;
  GaugeHolder holder(problem, before, free);
  if (holder.Hold() == 0) return "";
  const auto none = [](const std::vector<uint8_t>& bits) {
    return std::all_of(bits.begin(), bits.end(), [](uint8_t b) { return b == 0; });
  };
  if (none(before.pose) && none(before.frame) && none(before.sensor)) return "";
  return "Gauge two_cameras fixes only one position: all refined poses have this position, so the "
         "scale is free.";
}

}  // namespace bundle
