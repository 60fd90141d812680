#include "core/solve/solver_checks.h"

#include <gtest/gtest.h>

#include <string>

#include "core/error.h"

namespace bundle {
namespace {

TEST(SolverChecks, RefuseAFactorBeyondMemoryWithItsSize) {
  EXPECT_NO_THROW(RefuseTooMuchMemory(LinearSolverType::kSparseSchur, 1e3));
  try {
    RefuseTooMuchMemory(LinearSolverType::kSparseSchur, 1e17);
    FAIL() << "not refused";
  } catch (const InputError& error) {
    const std::string message = error.what();
    EXPECT_EQ(message.rfind("linear_solver_type: SPARSE_SCHUR needs 88.8 PiB for its factor, ", 0),
              0)
        << message;
    EXPECT_NE(message.find(" free; use iterative_schur"), std::string::npos) << message;
  }
}

}  // namespace
}  // namespace bundle
