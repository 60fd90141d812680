#include "core/ceres/summarize.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace bundle {
namespace {

using Kinds = std::vector<WarningKind>;

constexpr WarningKind kSolver = WarningKind::kSolverReplaced;
constexpr WarningKind kPreconditioner = WarningKind::kPreconditionerReplaced;

Kinds KindsOf(const std::vector<Warning>& warnings) {
  Kinds kinds;
  for (const Warning& warning : warnings) kinds.push_back(warning.kind);
  return kinds;
}

ceres::Solver::Summary Used(ceres::LinearSolverType type,
                            ceres::PreconditionerType preconditioner) {
  ceres::Solver::Summary summary;
  summary.linear_solver_type_given = ceres::ITERATIVE_SCHUR;
  summary.preconditioner_type_given = ceres::SCHUR_JACOBI;
  summary.linear_solver_type_used = type;
  summary.preconditioner_type_used = preconditioner;
  return summary;
}

TEST(FindFallbacks, NamesWhatWasReplaced) {
  const auto kinds = [](ceres::LinearSolverType type, ceres::PreconditionerType preconditioner) {
    return KindsOf(FindFallbacks(Used(type, preconditioner)));
  };
  EXPECT_EQ(kinds(ceres::ITERATIVE_SCHUR, ceres::SCHUR_JACOBI), Kinds{});
  EXPECT_EQ(kinds(ceres::CGNR, ceres::JACOBI), (Kinds{kSolver, kPreconditioner}));
  EXPECT_EQ(kinds(ceres::ITERATIVE_SCHUR, ceres::JACOBI), Kinds{kPreconditioner});
  const std::string text = FindFallbacks(Used(ceres::CGNR, ceres::SCHUR_JACOBI))[0].text;
  EXPECT_LT(text.find("ITERATIVE_SCHUR"), text.find("CGNR"));
}

TEST(FindFallbacks, SaysNothingOfAPreconditionerThatNobodyReads) {
  EXPECT_EQ(KindsOf(FindFallbacks(Used(ceres::DENSE_QR, ceres::IDENTITY))), Kinds{kSolver});
}

}  // namespace
}  // namespace bundle
