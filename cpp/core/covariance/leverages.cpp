#include "core/covariance/leverages.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <type_traits>
#include <vector>

#include "core/covariance/point_pairs.h"

namespace bundle {
namespace {

using Eigen::Matrix2d;

/// Columns of a block of C, `stride` numbers apart.
template <typename Scalar>
struct BlockOfInverse {
  const Scalar* values;
  int64_t stride;
};

/// Two numbers of one scalar type side by side: of both coordinates of an observation.
template <typename Scalar>
struct Both {
  Scalar of[2];
};

/// to_c += sum_r J_r B_rc of a block B of C, or of its transpose. `is_half`: only the lower
/// triangle is defined.
template <typename Scalar>
void AddTimes(const Both<Scalar>* j, int rows, int columns, const BlockOfInverse<Scalar>& block,
              bool is_transposed, bool is_half, Both<Scalar>* to) {
  for (int c = 0; c < columns; ++c) {
    Scalar first = to[c].of[0], second = to[c].of[1];
    const auto add = [&](int r, int64_t at) {
      first += block.values[at] * j[r].of[0];
      second += block.values[at] * j[r].of[1];
    };
    int r = 0;
    for (const int end = is_half ? c : is_transposed ? rows : 0; r < end; ++r) {
      add(r, r * block.stride + c);
    }
    for (; r < rows; ++r) add(r, c * block.stride + r);
    to[c] = {{first, second}};
  }
}

/// Leverages of the observations of one point, or of none, from blocks of C.
template <typename Scalar>
class Leverages final : public PointLeverages {
 public:
  Leverages(const ReducedSystem& system, const LongMatrix& inverse)
      : system_(system), inverse_(inverse) {}

  /// A_x C A_y^T
  Eigen::Matrix<Scalar, 2, 2> OfCameras(const ObservationRows& x, const ObservationRows& y) const {
    Block2 sum = Block2::Zero();
    for (int a = 0; a < x.num_blocks; ++a) {
      for (int b = 0; b < y.num_blocks; ++b) sum += Product(x, a, y, b);
    }
    return sum;
  }

  /// C Y and Y^T C Y of a point; keeps references
  void TakePoint(const PointBlocks& blocks, const PointAssembler& assembler) {
    blocks_ = &blocks;
    assembler_ = &assembler;
    cy_.resize(blocks.y.size() / 3 * 4);
    if constexpr (kIsWhole) {
      MultiplyWhole();
    } else {
      y_.Set(blocks.y);
      MultiplyPairs(system_, system_.values(), blocks, y_, &cy_);
    }
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) {
        Scalar sum = 0;
        for (int row = 0; row < blocks.begin.back(); ++row) {
          sum += blocks.y[3 * size_t(row) + i] * cy_[4 * size_t(row) + k];
        }
        by_cameras_(i, k) = sum;
      }
    }
  }

  Eigen::Matrix3d Covariance() const override {
    return Eigen::Map<const Eigen::Matrix3d>(blocks_->inverse) +
           by_cameras_.template cast<double>();
  }

  /// A_x C first, by all unknowns of the point, then the blocks of y.
  Eigen::MatrixXd OfCameras() const override {
    const int m = assembler_->num_rows();
    const auto row = [this](int i) -> const ObservationRows& { return assembler_->row(i); };
    std::vector<std::array<int, ObservationRows::kMaxBlocks>> index(m);  // blocks of the rows
    std::vector<Row3> acy(m);
    for (int i = 0; i < m; ++i) {
      acy[i] = TimesCy(row(i));
      for (int b = 0; b < row(i).num_blocks; ++b) index[i][b] = IndexOf(row(i).block[b]);
    }
    std::vector<Both<Scalar>> ac(blocks_->begin.back());
    Eigen::MatrixXd all = Eigen::MatrixXd::Zero(2 * m, 2 * m);
    for (int i = 0; i < m; ++i) {
      std::fill(ac.begin(), ac.end(), Both<Scalar>{});
      for (int a = 0; a < row(i).num_blocks; ++a) AddBlockRows(row(i), a, index[i][a], &ac);
      for (int j = 0; j <= i; ++j) {
        const ObservationRows& y = row(j);
        Block2 sum = PartOfPoint(row(i), acy[i], y, acy[j]);
        for (int b = 0; b < y.num_blocks; ++b) {
          const Both<Scalar>* const from = &ac[blocks_->begin[index[j][b]]];
          for (int r = 0; r < y.size[b]; ++r) {
            const double jacobian[2] = {y.jacobian[b][r], y.jacobian[b][y.size[b] + r]};
            for (int k = 0; k < 4; ++k) sum(k / 2, k % 2) += from[r].of[k / 2] * jacobian[k % 2];
          }
        }
        all.block<2, 2>(2 * i, 2 * j) = sum.template cast<double>();
      }
    }
    return all;
  }

  /// h
  Matrix2d OfPoint(const ObservationRows& rows) const {
    const Row3 b = ByPoint(rows), acy = TimesCy(rows);
    const Row3 own =
        b.lazyProduct(Eigen::Map<const Eigen::Matrix3d>(blocks_->inverse).template cast<Scalar>());
    const Block2 h =
        OfCameras(rows, rows) + PartOfPoint(rows, acy, rows, acy) + own.lazyProduct(b.transpose());
    return h.template cast<double>();
  }

 private:
  using Block2 = Eigen::Matrix<Scalar, 2, 2>;
  using Row3 = Eigen::Matrix<Scalar, 2, 3>;

  /// B
  static Row3 ByPoint(const ObservationRows& rows) {
    return Eigen::Map<const Eigen::Matrix<double, 2, 3, Eigen::RowMajor>>(rows.point)
        .template cast<Scalar>();
  }

  /// C Y by rows, whose sums stay in registers: long doubles take long to store.
  void MultiplyWhole() {
    const std::vector<int>& begin = blocks_->begin;
    for (size_t a = 0; a < blocks_->blocks.size(); ++a) {
      for (int row = begin[a]; row < begin[a + 1]; ++row) {
        Scalar sum[3] = {};
        const double* y = blocks_->y.data();
        for (size_t b = 0; b < blocks_->blocks.size(); ++b) {
          const BlockOfInverse<Scalar> block = BlockOf(blocks_->blocks[a], blocks_->blocks[b]);
          const Scalar* value = block.values + (row - begin[a]);
          for (int c = begin[b]; c < begin[b + 1]; ++c, y += 3, value += block.stride) {
            for (int k = 0; k < 3; ++k) sum[k] += *value * y[k];
          }
        }
        std::copy_n(sum, 3, &cy_[4 * size_t(row)]);
      }
    }
  }

  /// Place of a block among those of the point.
  int IndexOf(int block) const {
    return static_cast<int>(
        std::lower_bound(blocks_->blocks.begin(), blocks_->blocks.end(), block) -
        blocks_->blocks.begin());
  }

  /// Adds A C of a block of an observation, the point's block `index`.
  void AddBlockRows(const ObservationRows& x, int a, int index,
                    std::vector<Both<Scalar>>* ac) const {
    const int i = blocks_->blocks[index], rows = x.size[a];
    Both<Scalar> j[BlockSystem::kMaxBlockSize];
    for (int r = 0; r < rows; ++r) j[r] = {{x.jacobian[a][r], x.jacobian[a][rows + r]}};
    for (size_t b = 0; b < blocks_->blocks.size(); ++b) {
      const int other = blocks_->blocks[b], first = blocks_->begin[b];
      const bool is_transposed = !kIsWhole && i < other;
      AddTimes(j, rows, blocks_->begin[b + 1] - first,
               is_transposed ? BlockOf(other, i) : BlockOf(i, other), is_transposed,
               !kIsWhole && i == other, &(*ac)[first]);
    }
  }

  /// A C Y
  Row3 TimesCy(const ObservationRows& rows) const {
    Row3 acy;
    const Scalar* first[ObservationRows::kMaxBlocks];
    for (int k = 0; k < rows.num_blocks; ++k) {
      first[k] = &cy_[4 * size_t(blocks_->begin[IndexOf(rows.block[k])])];
    }
    for (int m = 0; m < 3; ++m) {
      Scalar sum[2] = {};
      for (int k = 0; k < rows.num_blocks; ++k) {
        const double* const j = rows.jacobian[k];
        for (int r = 0; r < rows.size[k]; ++r) {
          const Scalar value = first[k][4 * r + m];
          sum[0] += j[r] * value;
          sum[1] += j[rows.size[k] + r] * value;
        }
      }
      acy(0, m) = sum[0];
      acy(1, m) = sum[1];
    }
    return acy;
  }

  /// T_x C T_y^T - A_x C A_y^T of two observations of the point, multiplied out
  Block2 PartOfPoint(const ObservationRows& x, const Row3& acy_x, const ObservationRows& y,
                     const Row3& acy_y) const {
    const Row3 bx = ByPoint(x), by = ByPoint(y);
    const Row3 along = bx.lazyProduct(by_cameras_) - acy_x;
    return along.lazyProduct(by.transpose()) - bx.lazyProduct(acy_y.transpose());
  }

  /// Use of both triangles, for an inverse in long doubles: each column solves the equations up to
  /// rounding, so that its errors are along directions that the rows of J hardly see. With half of
  /// another column, they are not.
  static constexpr bool kIsWhole = !std::is_same_v<Scalar, double>;

  /// Block (i, j); i >= j unless C is whole.
  BlockOfInverse<Scalar> BlockOf(int i, int j) const {
    if constexpr (kIsWhole) {
      const std::vector<CameraBlock>& blocks = system_.layout().blocks();
      const Eigen::Index rows = inverse_.rows();
      return {inverse_.data() + blocks[i].offset + rows * blocks[j].offset, rows};
    } else {
      const BlockStructure& s = system_.structure();
      return {system_.values().data() + s.ValueIndex(j, s.Entry(j, i), 0, 0), s.panel_stride[j]};
    }
  }

  /// A_a C_ab A_b^T of a block of x and one of y
  Block2 Product(const ObservationRows& x, int a, const ObservationRows& y, int b) const {
    if (!kIsWhole && x.block[a] < y.block[b]) return Product(y, b, x, a).transpose();
    Block2 sum = Block2::Zero();
    const BlockOfInverse<Scalar> block = BlockOf(x.block[a], y.block[b]);
    const int size_a = x.size[a], size_b = y.size[b];
    const double *const ja = x.jacobian[a], *const jb = y.jacobian[b];
    const bool is_half = !kIsWhole && x.block[a] == y.block[b];
    for (int c = 0; c < size_b; ++c) {
      const Scalar* const column = block.values + c * block.stride;
      Scalar down[2] = {}, across[2] = {};  // along the column, and along the row beside it
      for (int r = is_half ? c : 0; r < size_a; ++r) {
        for (int k = 0; k < 2; ++k) down[k] += ja[k * size_a + r] * column[r];
        for (int k = 0; k < 2 && is_half && r > c; ++k) across[k] += column[r] * jb[k * size_b + r];
      }
      for (int row = 0; row < 2; ++row) {
        for (int k = 0; k < 2; ++k) {
          sum(row, k) += down[row] * jb[k * size_b + c];
          if (is_half) sum(row, k) += ja[row * size_a + c] * across[k];
        }
      }
    }
    return sum;
  }

  const ReducedSystem& system_;
  const LongMatrix& inverse_;
  const PointBlocks* blocks_ = nullptr;
  const PointAssembler* assembler_ = nullptr;
  PaddedRows y_;            ///< unless C is whole
  std::vector<Scalar> cy_;  ///< rows of four numbers
  Eigen::Matrix<Scalar, 3, 3> by_cameras_ = Eigen::Matrix<Scalar, 3, 3>::Zero();
};

template <typename Scalar>
void VisitLeverages(const ReducedSystem& system, const LongMatrix& inverse,
                    const std::vector<int>& points, const LeverageVisitor& of_observation,
                    const PointLeverageVisitor& of_point, const LeverageOptions& wanted) {
  const auto take = [&](const ObservationRows& rows, const auto& leverage) {
    Leverage of = {rows.observation, {}, rows.weight, rows.bend, Matrix2d::Zero(), {}, &rows};
    std::copy_n(rows.residual, 2, of.residual);
    if (!wanted.without_h) of.h = leverage();
    of_observation(of);
  };
  std::vector<Leverages<Scalar>> of_thread(system.num_threads(), {system, inverse});
  system.ForPoints(system.num_threads(), points,
                   [&](int p, const PointBlocks& blocks, const PointAssembler& rows, int thread) {
                     Leverages<Scalar>& leverages = of_thread[thread];
                     if (!wanted.without_h || wanted.of_points) leverages.TakePoint(blocks, rows);
                     if (of_point) of_point(p, blocks, rows, leverages);
                     for (int i = 0; i < rows.num_rows(); ++i) {
                       take(rows.row(i), [&] { return leverages.OfPoint(rows.row(i)); });
                     }
                   });
  system.ForObservationsOfFixedPoints([&](const ObservationRows& rows) {
    take(rows,
         [&]() -> Matrix2d { return of_thread[0].OfCameras(rows, rows).template cast<double>(); });
  });
}

}  // namespace

void ForLeverages(const ReducedSystem& system, const LongMatrix& inverse,
                  const LeverageVisitor& of_observation, const PointLeverageVisitor& of_point,
                  const LeverageOptions& wanted) {
  if (inverse.size() > 0) {
    VisitLeverages<long double>(system, inverse, system.free_points(), of_observation, of_point,
                                wanted);
    return;
  }
  std::vector<int> points = system.unclear_points();
  points.insert(points.end(), wanted.points.begin(), wanted.points.end());
  std::sort(points.begin(), points.end());
  points.erase(std::unique(points.begin(), points.end()), points.end());
  std::vector<uint8_t> has_rows(system.problem().num_points);
  for (const int p : points) has_rows[p] = 1;
  if (points.size() < system.free_points().size()) {
    system.FindLeverages(
        wanted.without_h, wanted.adjoint, wanted.covariances,
        [&](int64_t i, const ObservationLeverage& found) {
          if (!points.empty() && has_rows[system.problem().observation_point[i]] != 0) return;
          double rho[3];
          system.evaluator().LossOf(found.residual, rho);
          const double root = std::sqrt(rho[1]);
          Leverage of = {i, {root * found.residual[0], root * found.residual[1]}, rho[1], 0, {},
                         {}};
          of.bend = rho[2] == 0 || rho[1] == 0 ? 0 : 2 * rho[2] / (rho[1] * rho[1]);
          of.h << found.h[0], found.h[1], found.h[1], found.h[2];
          std::copy_n(found.along, 2, of.along);
          of_observation(of);
        });
    for (const int p : points) {
      if (wanted.covariances == nullptr) break;
      std::fill_n(wanted.covariances + 9 * int64_t{p}, 9, std::numeric_limits<double>::quiet_NaN());
    }
  }
  VisitLeverages<double>(system, inverse, points, of_observation, of_point, wanted);
}

}  // namespace bundle
