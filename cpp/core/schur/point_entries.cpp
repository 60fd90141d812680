#include "core/schur/point_entries.h"

#include "core/parallel/thread_pool.h"

namespace bundle {

PointSizes::PointSizes(const EliminationPlan& plan, const ImageOrder& images,
                       const ImageParts& parts, ThreadPool* pool)
    : plan_(plan), num_refined_(plan.point.size(), 0), num_entries_(plan.point.size()) {
  ParallelFor(plan.num_points(), pool, [&](int64_t begin, int64_t end) {
    PointEntries entries(plan, parts);
    for (auto p = static_cast<int>(begin); p < end; ++p) {
      for (int64_t k = plan.first[p]; k < plan.first[p + 1]; ++k) {
        num_refined_[p] += images.refined[plan.image[k]];
      }
      entries.Find(p, num_refined_[p]);
      num_entries_[p] = entries.size();
    }
  });
}

}  // namespace bundle
