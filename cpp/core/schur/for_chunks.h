#pragma once

/// The loop of a pass over the chunks of a SchurProblem, on all threads.

#include <atomic>

#include "core/schur/assembly/ordered_sums.h"
#include "core/schur/schur_problem.h"

namespace bundle {

template <typename Visit, typename Done>
void SchurProblem::ForChunks(const Visit& visit, const Done& done) {
  const auto count = static_cast<int>(plan_.chunks.size());
  std::atomic<int> next{0};
  pool_.Run([&](int thread) {
    try {
      for (int c = next.fetch_add(1); c < count; c = next.fetch_add(1)) {
        visit(c, thread);
      }
      done(thread);
    } catch (const OrderedSums::Abandoned&) {  // the exception of the other thread is rethrown
    } catch (...) {
      next.store(count);
      sums_.Abandon();
      throw;
    }
  });
}

template <typename Visit>
void SchurProblem::ForChunks(const Visit& visit) {
  ForChunks(visit, [](int) {});
}

}  // namespace bundle
