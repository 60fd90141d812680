#include "core/covariance/sandwich.h"

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <vector>

#include "core/covariance/symmetric_sum.h"
#include "core/geometry/rotation.h"
#include "core/linear/symmetric_product.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

/// Number of columns of D per solve.
constexpr int kColumnsAtOnce = 256;

double Dot3(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/// Y P Y^T - F Y^T - Y F^T
void AddEliminated(const PointBlocks& blocks, const PointScores& scores, SymmetricSum* sum) {
  for (size_t a = 0; a < blocks.blocks.size(); ++a) {
    for (size_t b = 0; b <= a; ++b) {
      sum->Add(blocks.blocks[a], blocks.blocks[b], [&](int r, int c) {
        const size_t at_r = 3 * size_t(blocks.begin[a] + r), at_c = 3 * size_t(blocks.begin[b] + c);
        double by_p[3];
        VectorMatrix3(&blocks.y[at_r], scores.p, by_p);
        return Dot3(by_p, &blocks.y[at_c]) - Dot3(&scores.f[at_r], &blocks.y[at_c]) -
               Dot3(&blocks.y[at_r], &scores.f[at_c]);
      });
    }
  }
}

/// Adds j^T j of one row of a factor; parameters held on bounds are ignored.
void AddFactorRow(const BlockStructure& s, const std::vector<uint8_t>& held,
                  const std::vector<int>& unknowns, const double* j, BlockValues* values) {
  const auto is_held = [&](int unknown) { return !held.empty() && held[unknown] != 0; };
  for (size_t a = 0; a < unknowns.size(); ++a) {
    for (size_t b = 0; b < unknowns.size(); ++b) {
      if (is_held(unknowns[a]) || is_held(unknowns[b])) continue;
      const int row = s.BlockOf(unknowns[a]), column = s.BlockOf(unknowns[b]);
      if (row < column) continue;
      (*values)[s.ValueIndex(column, s.Entry(column, row), unknowns[a] - s.offset[row],
                             unknowns[b] - s.offset[column])] += j[a] * j[b];
    }
  }
}

}  // namespace

void AddFactors(const ReducedSystem& system, BlockValues* values) {
  system.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    if (!rows.points.empty()) return;  // included in V or P of the point
    for (int row = 0; row < rows.num_rows; ++row) {
      AddFactorRow(system.structure(), system.held(), rows.unknowns,
                   &rows.jacobian[row * rows.unknowns.size()], values);
    }
  });
}

void SumScores(const PointBlocks& blocks, const PointAssembler& assembler, const double* prior,
               PointScores* scores) {
  std::fill_n(scores->p, 9, 0.0);
  if (prior != nullptr) std::copy_n(prior, 9, scores->p);
  scores->f.assign(blocks.w.size(), 0.0);
  for (int i = 0; i < assembler.num_rows(); ++i) {
    const ObservationRows& rows = assembler.row(i);
    double of_point[3], share[BlockSystem::kMaxBlockSize];
    PointShare(rows, of_point);
    for (int k = 0; k < 9; ++k) scores->p[k] += of_point[k / 3] * of_point[k % 3];
    for (int b = 0; b < rows.num_blocks; ++b) {
      ShareOf(rows, b, share);
      const auto at = std::lower_bound(blocks.blocks.begin(), blocks.blocks.end(), rows.block[b]);
      double* to = &scores->f[3 * size_t(blocks.begin[at - blocks.blocks.begin()])];
      for (int r = 0; r < rows.size[b]; ++r, to += 3) {
        for (int k = 0; k < 3; ++k) to[k] += share[r] * of_point[k];
      }
    }
  }
}

BlockValues SumBread(const ReducedSystem& system) {
  const BlockStructure& s = system.structure();
  BlockValues bread(static_cast<size_t>(s.num_values), 0.0);
  SymmetricSum sum(s, &bread);
  system.ForPoints(1, [&](int, const PointBlocks& blocks, const PointAssembler& rows, int) {
    for (int i = 0; i < rows.num_rows(); ++i) sum.AddOwn(rows.row(i), 1, 0);
    sum.SubtractEliminated(blocks);
  });
  system.ForObservationsOfFixedPoints([&](const ObservationRows& rows) { sum.AddOwn(rows, 1, 0); });
  AddFactors(system, &bread);
  return bread;
}

void ExpectScatter(const PointAssembler& assembler, double variance, const double* prior,
                   double p[9]) {
  std::fill_n(p, 9, 0.0);
  if (prior != nullptr) std::copy_n(prior, 9, p);
  for (int i = 0; i < assembler.num_rows(); ++i) {
    const ObservationRows& rows = assembler.row(i);
    if (rows.weight == 0) continue;
    const double* const b = rows.point;
    const double share = variance / rows.weight;
    for (int k = 0; k < 9; ++k) {
      p[k] += share * (b[k / 3] * b[k % 3] + b[3 + k / 3] * b[3 + k % 3]);
    }
  }
}

BlockValues SumMeat(const ReducedSystem& system, double variance, ScatterGauge* gauge) {
  const BlockStructure& s = system.structure();
  BlockValues meat(static_cast<size_t>(s.num_values), 0.0);
  SymmetricSum sum(s, &meat);
  const std::vector<double>& prior = system.tracks().prior;
  // Uses one thread: points share blocks, and the bits must not depend on the order of threads.
  system.ForPoints(1, [&](int point, const PointBlocks& blocks, const PointAssembler& rows, int) {
    const double* const of_prior = prior.empty() ? nullptr : &prior[9 * size_t(point)];
    PointScores scores;
    SumScores(blocks, rows, of_prior, &scores);
    for (int i = 0; i < rows.num_rows(); ++i) sum.AddOwn(rows.row(i), 0, 1);
    AddEliminated(blocks, scores, &sum);
    if (gauge == nullptr) return;
    double expected[9];
    ExpectScatter(rows, variance, of_prior, expected);
    gauge->AddPoint(point, blocks, expected);
  });
  system.ForObservationsOfFixedPoints([&](const ObservationRows& rows) { sum.AddOwn(rows, 0, 1); });
  AddFactors(system, &meat);
  return meat;
}

LinearSolution SolveForScatter(ReducedSystem* system, const BlockValues& meat,
                               const ScatterGauge* gauge, BlockValues* scatter) {
  const BlockStructure& s = system->structure();
  const Eigen::Index n = s.num_columns();
  scatter->assign(meat.size(), 0.0);
  SymmetricProduct product(s, system->num_threads());
  Eigen::MatrixXd x, y, of_columns;
  for (int first = 0; first < s.num_blocks();) {
    ThrowIfInterrupted();
    int last = first + 1;
    while (last < s.num_blocks() && s.offset[last + 1] - s.offset[first] <= kColumnsAtOnce) ++last;
    const int columns = s.offset[last] - s.offset[first];
    const int begin = s.offset[first];
    x.setZero(n, columns);
    if (gauge != nullptr) {
      y = gauge->UnitColumns(begin, columns);
    } else {
      y.setZero(n, columns);
      for (int c = 0; c < columns; ++c) y(begin + c, c) = 1;
    }
    LinearSolution solution = system->Solve(y.data(), columns, x.data());
    if (solution.status != LinearStatus::kSuccess) return solution;
    if (gauge != nullptr) gauge->RemoveGauge(x);
    for (int c = 0; c < columns; ++c) product.Multiply(meat, x.col(c).data(), y.col(c).data());
    if (gauge != nullptr) gauge->RemoveGauge(y);
    of_columns.setZero(n, columns);
    solution = system->Solve(y.data(), columns, of_columns.data());
    if (solution.status != LinearStatus::kSuccess) return solution;
    if (gauge != nullptr) gauge->RemoveGauge(of_columns);
    for (int j = first; j < last; ++j) {
      for (int64_t e = s.column_begin[j]; e < s.column_begin[j + 1]; ++e) {
        const int i = s.row_block[e];
        for (int c = 0; c < s.block_size(j); ++c) {
          const double* const from = &of_columns(s.offset[i], s.offset[j] - begin + c);
          for (int r = 0; r < s.block_size(i); ++r) {
            (*scatter)[s.ValueIndex(j, e, r, c)] = from[r];
          }
        }
      }
    }
    first = last;
  }
  return {};
}

FullVectors MeatTimes(const ReducedSystem& system, const FullVectors& x) {
  const auto n = static_cast<size_t>(system.num_unknowns());
  const size_t num_coordinates = 3 * static_cast<size_t>(system.problem().num_points);
  FullVectors product;
  product.num_columns = x.num_columns;
  product.cameras.assign(x.cameras.size(), 0.0);
  product.points.assign(x.points.size(), 0.0);
  // Adds psi (psi^T x) of one observation. If its point is constant (-1), only the camera part.
  const auto add = [&](const ObservationRows& rows, int point, std::vector<double>* cameras) {
    double of_point[3], shares[ObservationRows::kMaxBlocks][BlockSystem::kMaxBlockSize];
    PointShare(rows, of_point);
    for (int b = 0; b < rows.num_blocks; ++b) ShareOf(rows, b, shares[b]);
    for (int m = 0; m < x.num_columns; ++m) {
      const size_t at = m * num_coordinates + 3 * size_t(std::max(point, 0));
      double along = 0;
      for (int k = 0; point >= 0 && k < 3; ++k) along += of_point[k] * x.points[at + k];
      for (int b = 0; b < rows.num_blocks; ++b) {
        const double* const from =
            &x.cameras[m * n + system.layout().blocks()[rows.block[b]].offset];
        for (int k = 0; k < rows.size[b]; ++k) along += shares[b][k] * from[k];
      }
      for (int b = 0; b < rows.num_blocks; ++b) {
        double* const to = &(*cameras)[m * n + system.layout().blocks()[rows.block[b]].offset];
        for (int k = 0; k < rows.size[b]; ++k) to[k] += along * shares[b][k];
      }
      for (int k = 0; point >= 0 && k < 3; ++k) product.points[at + k] += along * of_point[k];
    }
  };
  std::vector<std::vector<double>> of_thread(system.num_threads(), product.cameras);
  system.ForPoints([&](int point, const PointBlocks&, const PointAssembler& rows, int thread) {
    for (int i = 0; i < rows.num_rows(); ++i) add(rows.row(i), point, &of_thread[thread]);
  });
  for (const std::vector<double>& sum : of_thread) {
    for (size_t i = 0; i < sum.size(); ++i) product.cameras[i] += sum[i];
  }
  system.ForObservationsOfFixedPoints(
      [&](const ObservationRows& rows) { add(rows, -1, &product.cameras); });
  system.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    const size_t columns = 3 * rows.points.size() + rows.unknowns.size();
    const auto visit = [&](int m, const double* j, const auto& with) {
      for (const int point : rows.points) {
        for (int k = 0; k < 3; ++k) with(*j++, m * num_coordinates + 3 * size_t(point) + k, true);
      }
      for (const int unknown : rows.unknowns) with(*j++, m * n + unknown, false);
    };
    for (int row = 0; row < rows.num_rows; ++row) {
      const double* const j = &rows.jacobian[row * columns];
      for (int m = 0; m < x.num_columns; ++m) {
        double along = 0;
        visit(m, j, [&](double value, size_t at, bool is_point) {
          along += value * (is_point ? x.points : x.cameras)[at];
        });
        visit(m, j, [&](double value, size_t at, bool is_point) {
          (is_point ? product.points : product.cameras)[at] += value * along;
        });
      }
    }
  });
  return product;
}

FullVectors ReduceByPoints(const ReducedSystem& system, const FullVectors& x) {
  FullVectors reduced{x.num_columns, x.cameras, std::vector<double>(x.points.size(), 0.0)};
  const auto n = static_cast<size_t>(system.num_unknowns());
  const size_t num_coordinates = 3 * static_cast<size_t>(system.problem().num_points);
  system.ForPoints(1, [&](int point, const PointBlocks& blocks, const PointAssembler&, int) {
    for (int m = 0; m < x.num_columns; ++m) {
      const double* const from = &x.points[m * num_coordinates + 3 * size_t(point)];
      for (size_t b = 0; b < blocks.blocks.size(); ++b) {
        double* to = &reduced.cameras[m * n + system.layout().blocks()[blocks.blocks[b]].offset];
        for (int row = blocks.begin[b]; row < blocks.begin[b + 1]; ++row) {
          *to++ -= Dot3(&blocks.y[3 * size_t(row)], from);
        }
      }
    }
  });
  return reduced;
}

void AddOwnScatter(const ReducedSystem& system, double variance, const FullVectors& x,
                   FullVectors* to) {
  const auto n = static_cast<size_t>(system.num_unknowns());
  const size_t num_coordinates = 3 * static_cast<size_t>(system.problem().num_points);
  const std::vector<double>& prior = system.tracks().prior;
  system.ForPoints([&](int point, const PointBlocks& blocks, const PointAssembler& rows, int) {
    double p[9], once[3], twice[3];
    ExpectScatter(rows, variance, prior.empty() ? nullptr : &prior[9 * size_t(point)], p);
    for (int m = 0; m < x.num_columns; ++m) {
      const size_t at = m * num_coordinates + 3 * size_t(point);
      VectorMatrix3(&x.points[at], blocks.inverse, once);
      VectorMatrix3(once, p, twice);
      VectorMatrix3(twice, blocks.inverse, once);
      for (size_t b = 0; b < blocks.blocks.size(); ++b) {
        const double* from =
            &to->cameras[m * n + system.layout().blocks()[blocks.blocks[b]].offset];
        for (int row = blocks.begin[b]; row < blocks.begin[b + 1]; ++row, ++from) {
          for (int k = 0; k < 3; ++k) once[k] -= blocks.y[3 * size_t(row) + k] * *from;
        }
      }
      std::copy_n(once, 3, &to->points[at]);
    }
  });
}

}  // namespace bundle
