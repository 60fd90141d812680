#pragma once

#include "core/linear/linear_solver.h"
#include "core/minimize/least_squares.h"

namespace bundle {

/// What a trust region is told of a system that was solved for its Newton step.
inline NewtonResult AsNewtonResult(const LinearSolution& solution) {
  NewtonResult result;
  result.num_iterations = solution.num_iterations;
  result.message = solution.message;
  if (solution.status == LinearSolution::Status::kFatal) {
    result.status = NewtonResult::Status::kFatal;
  } else if (solution.status == LinearSolution::Status::kFailure) {
    result.status = NewtonResult::Status::kFailure;
  }
  return result;
}

}  // namespace bundle
