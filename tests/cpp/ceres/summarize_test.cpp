#include "core/ceres/summarize.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace bundle {
namespace {

using Sentences = std::vector<std::string>;

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
  EXPECT_EQ(FindFallbacks(Used(ceres::ITERATIVE_SCHUR, ceres::SCHUR_JACOBI)), Sentences{});
  EXPECT_EQ(FindFallbacks(Used(ceres::CGNR, ceres::JACOBI)),
            (Sentences{"Ceres replaced ITERATIVE_SCHUR by CGNR.",
                       "Ceres replaced the preconditioner SCHUR_JACOBI by JACOBI."}));
  EXPECT_EQ(FindFallbacks(Used(ceres::ITERATIVE_SCHUR, ceres::JACOBI)),
            Sentences{"Ceres replaced the preconditioner SCHUR_JACOBI by JACOBI."});
}

TEST(FindFallbacks, SaysNothingOfAPreconditionerThatNobodyReads) {
  EXPECT_EQ(FindFallbacks(Used(ceres::DENSE_QR, ceres::IDENTITY)),
            Sentences{"Ceres replaced ITERATIVE_SCHUR by DENSE_QR."});
}

}  // namespace
}  // namespace bundle
