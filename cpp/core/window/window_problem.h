#pragma once

/// A window as a problem for a trust region method (minimize/least_squares.h). Landmarks are
/// eliminated. Each has three numbers and the rows (J_c, J_l, r) of its observations. With W =
/// J_c^T J_l, H = J_l^T J_l + damping = L L^T, g = J_l^T r and V = W L^-T
///
///   S = J_c^T J_c - sum V V^T,    b = -(J_c^T r - sum V L^-1 g),    q_l = -L^-T (L^-1 g + V^T q_c)
///
/// over all landmarks. S has a block per pose, motion, camera and time offset. It is dense for a
/// window. For a long batch, it is sparse and solved by the supernodal factorisation, in AMD's or
/// METIS' order.
///
/// As in pose graphs (pose_graph/pose_graph_problem.h), the model predicts the decrease 1/2 (l q^T
/// D^2 q - g^T q) for a Newton step q of (H + l D^2) q = -g, so that no row is stored. q has no
/// component along unobservable directions (window_gauge.h).

#include <memory>
#include <vector>

#include "core/linear/linear_solver.h"
#include "core/minimize/least_squares.h"
#include "core/window/window_rows.h"
#include "core/window/window_structure.h"

namespace bundle {

class WindowProblem final : public LeastSquares {
 public:
  /// Keeps a reference to the view.
  explicit WindowProblem(const WindowView& view);

  Linearization Linearize(double damping) override;
  NewtonResult SolveNewton(double eta) override;
  Candidate EvaluateNewtonStep() override;
  void Accept() override;
  double StateNorm() const override { return x_norm_; }
  /// Levenberg-Marquardt does not call these two methods; both throw std::logic_error.
  DoglegProducts Products() override;
  Candidate EvaluateDoglegStep(double a, double b) override;

  const WindowState& x() const { return x_; }
  const WindowCosts& costs() const { return costs_; }  ///< at x
  int num_columns() const { return structure_.num_columns(); }
  double fill_ratio() const { return fill_ratio_; }  ///< WindowStructure::fill_ratio

  /// Eigenvalues, ascending, of S at x without damping, with its diagonal scaled to 1. For windows,
  /// whose S is dense. Empty if S is not finite.
  std::vector<double> ReducedSpectrum();

  /// The covariance of the last state, 15 x 15, from S at x without damping; empty if S is
  /// singular. `fix_gauge`: relative to the first state's position and yaw (minimum constraints).
  /// Biases and tilt, which the gauge does not move, are then the same as in any other gauge.
  std::vector<double> CovarianceOfLastState(bool fix_gauge);

  /// Expected cost of preintegrated samples at a minimum if all sigmas are right
  /// (window_certainty.cpp); NaN if S is singular. `fix_gauge` as above.
  double ExpectedImuCost(bool fix_gauge);

 private:
  struct Landmark {
    double hessian[6] = {};  ///< xx, xy, xl, yy, yl, ll; replaced by L
    double gradient[3] = {}, scale[3] = {}, d_squared[3] = {};
    double solved[3] = {};  ///< L^-1 g
    double newton[3] = {};
    bool is_regular = false;
  };
  /// A block of S in its column, or of w.
  struct BlockPlace {
    double* values = nullptr;
    int stride = 0;
    bool transposed = false;
  };

  BlockPlace Place(int a, int b);
  void AddBlock(int a, int b, const double* ja, const double* jb, int rows);
  void AddGradient(int a, const double* j, const double* r, int rows);
  void AddVisual(const VisualRows& row);
  void AddInertial(const InertialRows& row);
  void AddPrior(const WindowPrior& prior, const PriorForm& form);
  void AddLandmark(const VisualRows& row, Landmark* landmark);
  void AddAnchor(const AnchorRows& row, Landmark* landmark);
  bool FactorizeLandmark(Landmark* landmark);
  void Eliminate(Landmark* landmark);
  void Damp(double damping);
  int Column(int block) const { return structure_.offset[place_[block]]; }
  void FixGauge();
  void TakeOutFreeDirections();
  bool FactorizeUndamped(bool fix_gauge);
  double Weighted() const;
  double NormOf(const WindowState& state) const;

  const WindowView& view_;
  WindowState x_, candidate_;
  WindowCosts costs_, candidate_costs_;
  double x_norm_ = 0, candidate_norm_ = 0;

  std::vector<int> place_;  ///< block of S for each block of the window; -1: constant
  BlockStructure structure_;
  std::unique_ptr<LinearSolver> solver_;
  double fill_ratio_ = 1;
  BlockSystem system_;
  WindowRows rows_;
  std::vector<Landmark> landmarks_;
  std::vector<int> touched_;     ///< blocks on which the current landmark depends
  std::vector<int> touched_at_;  ///< index of a block in w; -1: not in w
  std::vector<double> w_;      ///< V of all landmarks: 3 rows per block, each over its coordinates
  std::vector<int> w_blocks_;  ///< blocks of all landmarks; ranges in w_begin_ and block_begin_
  std::vector<size_t> w_begin_, block_begin_;
  std::vector<double> gradient_, scale_, d_squared_, newton_;
  double damping_ = 0;
  bool is_scaled_ = false;
};

}  // namespace bundle
