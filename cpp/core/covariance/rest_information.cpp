#include "core/covariance/rest_information.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include "core/cameras/camera_model.h"
#include "core/covariance/eliminated_part.h"
#include "core/covariance/free_gauge.h"
#include "core/covariance/reduced_system.h"
#include "core/geometry/rotation.h"
#include "core/model/scene_frame.h"
#include "core/parallel/blas.h"

namespace bundle {
namespace {

/// Number of right-hand sides per solve.
constexpr int kColumns = 256;

/// An unknown of a layout by tangent coordinates: d(unknown) = sum value * d(coordinate).
struct TangentRow {
  int unknown = 0;
  std::vector<std::pair<int, double>> entries;
};

/// [c]x, row-major.
void CrossMatrix(const double* c, double* out) {
  const double values[9] = {0, -c[2], c[1], c[2], 0, -c[0], -c[1], c[0], 0};
  std::copy_n(values, 9, out);
}

template <typename Visit>
void ForPoses(const KeptVariables& kept, const AdjustmentProblem& problem, const Visit& visit) {
  for (const int image : kept.images) visit(image);
  for (const int frame : kept.frames) visit(PoseOfFrame(problem, frame));
}

/// The kept unknowns.
std::vector<TangentRow> FindTangentRows(const ReducedSystem& system, const SceneFrame& frame,
                                        bool is_moved, const KeptVariables& kept) {
  const ParameterLayout& layout = system.layout();
  std::vector<TangentRow> rows;
  int first = 0;
  ForPoses(kept, system.problem(), [&](int pose) {
    const int index = layout.pose_block(pose);
    first += kPoseSize;
    if (index < 0) return;
    const CameraBlock& block = layout.blocks()[index];
    const double* const rotation = system.states().pose(pose).rotation;
    double by_phi[9] = {};  // derivative of t' with respect to phi, -R [c]x
    if (is_moved) {
      double cross[9];
      CrossMatrix(frame.origin, cross);
      MatrixProduct3(rotation, cross, by_phi);
    }
    for (int k = 0; k < block.size && block.columns[k] < kPoseSize; ++k) {
      const int column = block.columns[k], axis = column % 3;
      const int begin = first - kPoseSize;
      TangentRow row{block.offset + k, {}};
      for (int j = 0; j < 3; ++j) {
        if (column < 3) {
          row.entries.emplace_back(begin + j, rotation[3 * axis + j]);
        } else {
          if (is_moved) row.entries.emplace_back(begin + j, -by_phi[3 * axis + j]);
          row.entries.emplace_back(begin + 3 + j, rotation[3 * axis + j]);
        }
      }
      rows.push_back(std::move(row));
    }
  });
  for (const int camera : kept.cameras) {
    if (const int index = layout.params_block(camera); index >= 0) {
      const CameraBlock& block = layout.blocks()[index];
      for (int k = 0; k < block.size; ++k) {
        if (block.columns[k] < kPoseSize) continue;
        rows.push_back({block.offset + k, {{first + block.columns[k] - kPoseSize, 1.0}}});
      }
    }
    first += system.problem().camera_models[camera]->num_params;
  }
  return rows;
}

/// Copies entries (i, j) of S for which both places, among rows and columns of `out`, are >= 0.
/// `out` is column-major and zero before.
void CopyEntries(const ReducedSystem& system, const std::vector<int>& row_of,
                 const std::vector<int>& column_of, size_t num_rows, double* out) {
  const BlockStructure& s = system.structure();
  const BlockValues& values = system.values();
  const auto put = [&](int i, int j, double value) {
    if (row_of[i] >= 0 && column_of[j] >= 0) out[column_of[j] * num_rows + row_of[i]] = value;
  };
  for (int column = 0; column < s.num_blocks(); ++column) {
    for (int64_t e = s.column_begin[column]; e < s.column_begin[column + 1]; ++e) {
      const int row = s.row_block[e];
      for (int c = 0; c < s.block_size(column); ++c) {
        for (int r = row == column ? c : 0; r < s.block_size(row); ++r) {
          const int i = s.offset[row] + r, j = s.offset[column] + c;
          const double value = values[s.ValueIndex(column, e, r, c)];
          put(i, j, value);
          if (i != j) put(j, i, value);
        }
      }
    }
  }
}

/// The diagonal of J^T J, before the points are eliminated.
std::vector<double> JacobianDiagonal(const ReducedSystem& system) {
  std::vector<std::vector<double>> sums(system.num_threads(),
                                        std::vector<double>(system.num_unknowns(), 0.0));
  const auto add = [&](const ObservationRows& rows, std::vector<double>* sum) {
    for (int b = 0; b < rows.num_blocks; ++b) {
      const int first = system.layout().blocks()[rows.block[b]].offset, size = rows.size[b];
      for (int k = 0; k < 2 * size; ++k) {
        (*sum)[first + k % size] += rows.jacobian[b][k] * rows.jacobian[b][k];
      }
    }
  };
  system.ForPoints([&](int, const PointBlocks&, const PointAssembler& rows, int thread) {
    for (int i = 0; i < rows.num_rows(); ++i) add(rows.row(i), &sums[thread]);
  });
  system.ForObservationsOfFixedPoints([&](const ObservationRows& rows) { add(rows, &sums[0]); });
  system.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    const size_t points = 3 * rows.points.size(), columns = points + rows.unknowns.size();
    for (size_t k = 0; k < rows.unknowns.size(); ++k) {
      for (int r = 0; r < rows.num_rows; ++r) {
        const double value = rows.jacobian[r * columns + points + k];
        sums[0][rows.unknowns[k]] += value * value;
      }
    }
  });
  std::vector<double> total = std::move(sums[0]);
  for (size_t t = 1; t < sums.size(); ++t) {
    for (size_t u = 0; u < total.size(); ++u) total[u] += sums[t][u];
  }
  return total;
}

/// C -= A^T X, with A and X num_rows x (columns of each), all column-major.
void Subtract(int num_rows, int a_columns, const double* a, int x_columns, const double* x,
              double* c) {
  if (num_rows == 0 || a_columns == 0 || x_columns == 0) return;
  const double minus = -1, one = 1;
  dgemm_("T", "N", &a_columns, &x_columns, &num_rows, &minus, a, &num_rows, x, &num_rows, &one, c,
         &a_columns);
}

}  // namespace

int TangentSize(const KeptVariables& kept, const AdjustmentProblem& problem) {
  size_t size = kPoseSize * (kept.images.size() + kept.frames.size());
  for (const int camera : kept.cameras) size += problem.camera_models[camera]->num_params;
  return static_cast<int>(size);
}

RestInformation MarginalizeRest(const AdjustmentProblem& problem, const SolveOptions& options,
                                const KeptVariables& kept) {
  const SceneFrame frame(problem);
  const CenteredProblem centered(problem, frame);
  const ReducedSystem system(centered.view(), options);
  const std::vector<TangentRow> rows = FindTangentRows(system, frame, centered.is_moved(), kept);
  const auto n = static_cast<size_t>(TangentSize(kept, problem));
  const auto num_kept = static_cast<int>(rows.size());

  RestInformation result;
  result.num_points = system.layout().num_free_points();
  result.num_null_points = static_cast<int>(system.null_points().size());
  std::vector<uint8_t> is_kept(system.num_unknowns(), 0);
  std::vector<int> kept_place(system.num_unknowns(), -1), place;
  for (int k = 0; k < num_kept; ++k) {
    is_kept[rows[k].unknown] = 1;
    kept_place[rows[k].unknown] = k;
  }
  const std::vector<double> diagonal = JacobianDiagonal(system);
  EliminatedPart part(system, diagonal);
  part.Take(is_kept, &place);
  part.Factorize();
  result.num_eliminated = part.size();
  result.is_regular = part.is_regular();

  // S_ab and S_bb, each with one more column for the right-hand side.
  const auto num_a = static_cast<size_t>(part.size()), num_b = static_cast<size_t>(num_kept);
  RefuseBeyondMemory(static_cast<double>(num_a + num_b) * static_cast<double>(num_b + 1) +
                         static_cast<double>(num_a) * 2 * kColumns +
                         2 * static_cast<double>(n) * static_cast<double>(n),
                     "its prior on " + std::to_string(num_kept) + " unknowns");
  std::vector<double> s_ab(num_a * (num_b + 1), 0.0), s_bb(num_b * (num_b + 1), 0.0);
  CopyEntries(system, place, kept_place, num_a, s_ab.data());
  CopyEntries(system, kept_place, kept_place, num_b, s_bb.data());
  for (int u = 0; u < system.num_unknowns(); ++u) {
    if (place[u] >= 0) s_ab[num_a * num_b + place[u]] = system.rhs()[u];
    if (kept_place[u] >= 0) s_bb[num_b * num_b + kept_place[u]] = system.rhs()[u];
  }
  const ScopedBlasThreads blas_threads(system.num_threads());
  std::vector<double> b, x;
  for (size_t first = 0; first < num_b + 1; first += kColumns) {
    const size_t count = std::min<size_t>(kColumns, num_b + 1 - first);
    b.assign(s_ab.begin() + first * num_a, s_ab.begin() + (first + count) * num_a);
    part.Solve(b, static_cast<int>(count), &x);
    Subtract(part.size(), num_kept, s_ab.data(), static_cast<int>(count), x.data(),
             s_bb.data() + first * num_b);
  }
  for (size_t j = 0; j < num_b; ++j) {
    for (size_t i = 0; i < j; ++i) {
      double& upper = s_bb[j * num_b + i];
      double& lower = s_bb[i * num_b + j];
      upper = lower = 0.5 * (upper + lower);
    }
  }

  // In tangent coordinates: M^T S M and M^T b.
  std::vector<double> half(num_b * n, 0.0);  // S M, row-major
  for (size_t j = 0; j < num_b; ++j) {
    for (const auto& [coordinate, value] : rows[j].entries) {
      for (size_t i = 0; i < num_b; ++i) half[i * n + coordinate] += s_bb[j * num_b + i] * value;
    }
  }
  result.lambda.assign(n * n, 0.0);
  result.eta.assign(n, 0.0);
  for (size_t i = 0; i < num_b; ++i) {
    for (const auto& [coordinate, value] : rows[i].entries) {
      double* const to = &result.lambda[coordinate * n];
      for (size_t j = 0; j < n; ++j) to[j] += value * half[i * n + j];
      result.eta[coordinate] += value * s_bb[num_b * num_b + i];
    }
  }
  for (size_t j = 0; j < n; ++j) {
    for (size_t i = 0; i < j; ++i) {
      double& upper = result.lambda[j * n + i];
      double& lower = result.lambda[i * n + j];
      upper = lower = 0.5 * (upper + lower);
    }
  }
  return result;
}

FreeSimilarities FindFreeSimilarities(const AdjustmentProblem& problem, const SolveOptions& options,
                                      const KeptVariables& kept) {
  const SceneFrame frame(problem);
  const CenteredProblem centered(problem, frame);
  const ReducedSystem system(centered.view(), options, /*sums_gauge=*/true);
  const FreeGauge gauge(system);
  FreeSimilarities result;
  result.degrees = gauge.degrees();
  const auto degrees = static_cast<size_t>(gauge.degrees());
  result.rows.assign(static_cast<size_t>(TangentSize(kept, problem)) * degrees, 0.0);
  size_t first = 0;
  ForPoses(kept, problem, [&](int pose) {
    double* const out = &result.rows[kPoseSize * degrees * first++];
    const int index = system.layout().pose_block(pose);
    if (index < 0) return;
    const CameraBlock& block = system.layout().blocks()[index];
    const double* const rotation = system.states().pose(pose).rotation;
    for (size_t m = 0; m < degrees; ++m) {
      double chart[kPoseSize] = {}, phi[3], rho[3], turned[3] = {};
      for (int k = 0; k < block.size && block.columns[k] < kPoseSize; ++k) {
        chart[block.columns[k]] = gauge.cameras()(block.offset + k, static_cast<Eigen::Index>(m));
      }
      // phi = R^T w, rho = R^T t' + c x phi
      VectorMatrix3(chart, rotation, phi);
      VectorMatrix3(chart + 3, rotation, rho);
      if (centered.is_moved()) Cross3(frame.origin, phi, turned);
      for (int j = 0; j < 3; ++j) {
        out[j * degrees + m] = phi[j];
        out[(3 + j) * degrees + m] = rho[j] + turned[j];
      }
    }
  });
  return result;
}

}  // namespace bundle
