/// Part of PointPasses (point_passes.h): the sums over all points.

#include <algorithm>
#include <cstddef>
#include <vector>

#include "core/covariance/point_passes.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

/// The lists filled by a pass.
struct SurveyLists {
  GaugeSums* gauge;
  int thread;
  std::vector<int> unclear;

  void ConnectTo(PointSurvey* survey) {
    survey->list = this;
    survey->add_row = [](void* list, const double* by_images, const double* by_point) {
      auto& self = *static_cast<SurveyLists*>(list);
      self.gauge->AddRow(by_images, by_point, self.thread);
    };
    survey->add_unclear = [](void* list, int point) {
      static_cast<SurveyLists*>(list)->unclear.push_back(point);
    };
  }
};

}  // namespace

template <typename Visit>
void PointPasses::ForBlocksOf(int image, const Visit& visit) const {
  const SchurSetup& setup = schur_.setup();
  const ModelGroup& group = setup.parts.groups()[setup.parts.image_group()[image]];
  for (int kind = 0; kind < kMaxParts; ++kind) {
    const int part = setup.parts.part_of(image, kind);
    if (part < 0) continue;
    for (const ColumnBlock& block : blocks_[part]) visit(block, 4 * group.parts[kind].first_quad);
  }
}

/// N, by columns of the records, and the images of which it moves all columns.
void PointPasses::FillMoves(const GaugeSums& gauge, std::vector<double>* images,
                            std::vector<uint8_t>* moves_along) const {
  const SchurSetup& setup = schur_.setup();
  const auto num_images = static_cast<size_t>(setup.problem.num_images);
  const size_t stride = static_cast<size_t>(schur_.input().record_columns) * kMoves;
  images->assign(num_images * stride, 0.0);
  moves_along->assign(num_images, 0);
  for (size_t i = 0; i < num_images; ++i) {
    const auto image = static_cast<int>(i);
    const ModelGroup& group = setup.parts.groups()[setup.parts.image_group()[i]];
    double* const rows = images->data() + i * stride;
    ForBlocksOf(image, [&](const ColumnBlock& block, int first_column) {
      const int offset = setup.layout.blocks()[block.block].offset;
      const auto num_columns =
          block.map.empty() ? 0 : static_cast<int>(block.map.size()) / block.size;
      for (int k = 0; k < block.size; ++k) {
        const SimilarityRow of = gauge.moves().OfUnknown(offset + k);
        const auto add = [&](int column, double factor) {
          double* const row = rows + size_t(first_column + column) * kMoves;
          for (int m = 0; m < kSimilarities; ++m) row[m] += factor * of[m];
        };
        if (block.map.empty()) add(block.column[k], 1);
        for (int c = 0; c < num_columns; ++c) add(c, block.map[size_t(c) * block.size + k]);
      }
    });
    const auto whole = gauge.moves().OfPose(schur_.cameras().pose(image));
    bool is_whole = setup.parts.part_of(image, kOwnPart) >= 0;
    if (setup.problem.HasRollingShutter(image)) is_whole &= setup.layout.free().twist[image] != 0;
    for (int c = 0; c < kPoseSize && is_whole; ++c) {
      is_whole = group.columns[c] == c;
      for (int m = 0; m < kSimilarities; ++m) is_whole &= rows[c * kMoves + m] == whole(c, m);
    }
    (*moves_along)[i] = is_whole ? 1 : 0;
  }
}

PointPasses::Found PointPasses::Survey(GaugeSums* gauge) const {
  const SchurSetup& setup = schur_.setup();
  const EliminationPlan& plan = setup.plan;
  const auto num_chunks = static_cast<int64_t>(plan.chunks.size());
  WorldMoves moves;
  std::vector<double> images;
  std::vector<uint8_t> moves_along;
  if (gauge != nullptr) {
    FillMoves(*gauge, &images, &moves_along);
    moves.images = images.data();
    moves.moves_along = moves_along.data();
    std::copy_n(gauge->moves().center(), 3, moves.center);
    moves.size = gauge->moves().size();
  }
  std::vector<PointSurvey> sums(num_threads_);
  std::vector<SurveyLists> lists(num_threads_);
  // Each thread has its own chunks, with about as many observations as the others, so that sums do
  // not depend on the speed of threads.
  const auto first_of = [&](int64_t thread) {
    const int64_t wanted = plan.num_observations() / num_threads_ * thread;
    const auto at =
        std::partition_point(plan.chunks.begin(), plan.chunks.end(),
                             [&](const Chunk& c) { return plan.first[c.first_point] < wanted; });
    return thread == num_threads_ ? num_chunks : at - plan.chunks.begin();
  };
  RunOnThreads(num_threads_, [&](int64_t thread) {
    std::vector<double> memory(setup.kernels.memory_doubles(schur_.input()));
    std::vector<double> eliminated(images.size());
    PointSurvey& survey = sums[thread];
    lists[thread].gauge = gauge;
    lists[thread].thread = static_cast<int>(thread);
    lists[thread].ConnectTo(&survey);
    survey.eliminated = eliminated.data();
    for (int64_t c = first_of(thread); c < first_of(thread + 1); ++c) {
      ThrowIfInterrupted();
      setup.kernels.survey_points(schur_.input(), schur_.records(), plan.chunks[c], moves,
                                  memory.data(), &survey);
    }
    if (gauge == nullptr) return;
    gauge->Add(survey, static_cast<int>(thread));
    AddEliminated(eliminated, gauge, static_cast<int>(thread));
  });
  Found found;
  for (int thread = 0; thread < num_threads_; ++thread) {
    found.squares += sums[thread].squares;
    found.decrease += sums[thread].decrease;
    found.num_residuals += 2 * sums[thread].num_observations;
    for (const int p : lists[thread].unclear) found.unclear.push_back(plan.point[p]);
  }
  std::sort(found.unclear.begin(), found.unclear.end());
  for (const HeldResidual& held : schur_.held()) {
    const auto next = std::upper_bound(plan.first.begin(), plan.first.end(), held.observation);
    const auto p = static_cast<int>(next - plan.first.begin()) - 1;
    if (p >= plan.num_free_points) break;
    if (!std::binary_search(found.unclear.begin(), found.unclear.end(), plan.point[p])) {
      found.num_residuals -= 2;
    }
  }
  // Adds free points without observations, which are in no chunk.
  std::vector<uint8_t> is_planned(setup.problem.num_points);
  for (int p = 0; p < plan.num_free_points; ++p) is_planned[plan.point[p]] = 1;
  const auto num_unclear = static_cast<std::ptrdiff_t>(found.unclear.size());
  for (int p = 0; p < setup.problem.num_points; ++p) {
    if (setup.layout.point_is_free(p) && is_planned[p] == 0) found.unclear.push_back(p);
  }
  std::inplace_merge(found.unclear.begin(), found.unclear.begin() + num_unclear,
                     found.unclear.end());
  return found;
}

void PointPasses::AddEliminated(const std::vector<double>& of_images, GaugeSums* gauge,
                                int thread) const {
  const SchurSetup& setup = schur_.setup();
  const size_t stride = static_cast<size_t>(schur_.input().record_columns) * kMoves;
  for (int i = 0; i < setup.problem.num_images; ++i) {
    ForBlocksOf(i, [&](const ColumnBlock& block, int first_column) {
      const double* const rows =
          of_images.data() + size_t(i) * stride + size_t(first_column) * kMoves;
      const int offset = setup.layout.blocks()[block.block].offset;
      for (int k = 0; k < block.size; ++k) {
        if (block.map.empty()) {
          gauge->AddEliminated(offset + k, rows + block.column[k] * kMoves, thread);
          continue;
        }
        double sum[kMoves] = {};
        for (size_t c = 0; c < block.map.size() / block.size; ++c) {
          const double factor = block.map[c * block.size + k];
          for (int m = 0; m < kMoves; ++m) sum[m] += factor * rows[c * kMoves + m];
        }
        gauge->AddEliminated(offset + k, sum, thread);
      }
    });
  }
}

}  // namespace bundle
