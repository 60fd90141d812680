#pragma once

#include <memory>
#include <string>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/prepare/prepare.h"

namespace bundle {

struct BackendChoice {
  Backend backend = Backend::kCeres;  ///< not kAuto
  std::string reason;                 ///< a sentence; "" if the backend was requested
};

/// Chooses the backend: the fused one if it supports the problem, unless the options name another.
///
/// Throws InputError, with the option, if the options name the fused backend and it does not
/// support them.
BackendChoice ChooseBackend(const SolveOptions& options, const PreparedSolve& prepared);

/// Returns the reason, in one sentence, if these options require Ceres for any problem; otherwise
/// "".
std::string ReasonForCeres(const SolveOptions& options);

/// Repeated bundle adjustment of one structure: the observed points of each image, the camera
/// models, the refined parameters and the method are constant; values and stopping rules may
/// change.
///
/// The fused backend keeps its threads, the layout, the order of the elimination, the analysed
/// linear solver and all buffers. A solve does no symbolic work and has the same bits as that of a
/// new solver. There are two exceptions. If the new values make the gauge hold other numbers, the
/// solve lays out everything anew. The two-level preconditioner forms its clusters from the values
/// of each solve. With Ceres, nothing is kept between solves.
///
/// In a forked process, the first solve lays out everything anew, because threads do not survive a
/// fork.
class Solver {
 public:
  /// Lays out everything. The problem is valid (problem_view.h). Its arrays, bounds and factors
  /// must outlive the solver and not change, except poses, camera parameters, points and
  /// measurements.
  ///
  /// Throws InputError as bundle::Solve below.
  Solver(const AdjustmentProblem& problem, const SolveOptions& options);
  ~Solver();
  Solver(const Solver&) = delete;
  Solver& operator=(const Solver&) = delete;

  /// Throws InputError if the problem has another structure.
  void CheckStructure(const ProblemView& problem) const;

  /// Solves from the values of a valid problem, within the bounds and with the factors of the
  /// constructor's problem; its own are ignored. Options may differ from the constructor's where
  /// CopyChangeable copies them; other differences have no effect. After an exception the solver
  /// can be used again.
  ///
  /// Throws InputError if the problem has another structure. Also throws it if the solver is in
  /// use: by another thread, or by this thread in a progress callback.
  SolveOutput Solve(const AdjustmentProblem& problem, const SolveOptions& options,
                    const ProgressCallback& progress);

 private:
  friend SolveOutput Solve(const AdjustmentProblem& problem, const SolveOptions& options,
                           const ProgressCallback& progress);
  class Impl;

  struct Once {};
  Solver(const AdjustmentProblem& problem, const SolveOptions& options, Once once);

  std::unique_ptr<Impl> impl_;
};

/// Bundle adjustment by the backend that the options select. The problem must be valid
/// (problem_view.h).
///
/// Throws InputError if a camera model is not supported, if an id to be fixed does not exist, if
/// options exclude each other or the backend, or if the dense matrices of the solver would not fit
/// into memory. Other reasons why a solve does not converge are in the summary.
SolveOutput Solve(const AdjustmentProblem& problem, const SolveOptions& options,
                  const ProgressCallback& progress);

}  // namespace bundle
