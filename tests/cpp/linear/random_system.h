#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include "core/linear/block_structure.h"
#include "support/dense_oracle.h"

namespace bundle {

/// A random reduced camera system S = U - W V^-1 W^T, with what made it. `coupling`: the chance
/// that two neighbouring blocks share a point.
struct RandomSystem {
  std::vector<int> sizes;
  std::vector<std::vector<int>> columns;
  Eigen::MatrixXd u;  ///< block diagonal
  Eigen::MatrixXd s;
  Eigen::VectorXd b;
  std::vector<double> scale;

  int num_columns() const { return static_cast<int>(b.size()); }
};

inline RandomSystem MakeRandomSystem(const std::vector<int>& sizes, double coupling,
                                     unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  RandomSystem system;
  system.sizes = sizes;
  std::vector<int> offset(1, 0);
  for (const int size : sizes) offset.push_back(offset.back() + size);
  const int n = offset.back();
  const int num_blocks = static_cast<int>(sizes.size());
  system.columns.resize(num_blocks);
  for (int j = 0; j < num_blocks; ++j) system.columns[j].push_back(j);

  system.u = Eigen::MatrixXd::Zero(n, n);
  std::vector<Eigen::MatrixXd> roots;  // of the blocks of U
  for (int j = 0; j < num_blocks; ++j) {
    const Eigen::MatrixXd a =
        Eigen::MatrixXd::NullaryExpr(4 * sizes[j], sizes[j], [&] { return normal(random); });
    const Eigen::MatrixXd block =
        a.transpose() * a / (4 * sizes[j]) + Eigen::MatrixXd::Identity(sizes[j], sizes[j]);
    system.u.block(offset[j], offset[j], sizes[j], sizes[j]) = block;
    roots.push_back(oracle::CholeskyFactor(block));
  }
  // What a coupling takes from the diagonal is bounded, so that S stays positive definite:
  // S = L (I - K) L^T with L L^T = U and the norm of K below 1.
  Eigen::MatrixXd k = Eigen::MatrixXd::Zero(n, n);
  for (int j = 0; j < num_blocks; ++j) {
    for (int i = j + 1; i < num_blocks; ++i) {
      if (uniform(random) >= coupling) continue;
      system.columns[j].push_back(i);
      const Eigen::MatrixXd block =
          Eigen::MatrixXd::NullaryExpr(sizes[i], sizes[j], [&] { return normal(random); });
      k.block(offset[i], offset[j], sizes[i], sizes[j]) = block;
      k.block(offset[j], offset[i], sizes[j], sizes[i]) = block.transpose();
    }
  }
  const double norm = n > 0 ? k.cwiseAbs().rowwise().sum().maxCoeff() : 0;
  if (norm > 0) k *= 0.9 / norm;
  system.s = system.u;
  for (int j = 0; j < num_blocks; ++j) {
    for (const int i : system.columns[j]) {
      if (i == j) continue;
      const auto coupled = k.block(offset[i], offset[j], sizes[i], sizes[j]);
      const Eigen::MatrixXd block = -(roots[i] * coupled * roots[j].transpose());
      system.s.block(offset[i], offset[j], sizes[i], sizes[j]) = block;
      system.s.block(offset[j], offset[i], sizes[j], sizes[i]) = block.transpose();
    }
  }
  system.b = Eigen::VectorXd::NullaryExpr(n, [&] { return normal(random); });
  for (int i = 0; i < n; ++i) system.scale.push_back(0.5 + uniform(random));
  return system;
}

/// Sizes from 1 to 22.
inline std::vector<int> RandomSizes(int num_blocks, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> size(1, 22);
  std::vector<int> sizes(num_blocks);
  for (int& s : sizes) s = size(random);
  return sizes;
}

/// The system as a solver gets it: zero where S has no block. What must not be read is NaN.
inline BlockSystem Store(const RandomSystem& from, const BlockStructure& structure) {
  BlockSystem system;
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  system.values.assign(structure.num_values, structure.dense ? kNaN : 0);
  for (int j = 0; j < structure.num_blocks(); ++j) {
    for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
      const int i = structure.row_block[e];
      for (int c = 0; c < structure.block_size(j); ++c) {
        for (int r = 0; r < structure.block_size(i); ++r) {
          system.values[structure.ValueIndex(j, e, r, c)] =
              i == j && r < c ? kNaN : from.s(structure.offset[i] + r, structure.offset[j] + c);
        }
      }
    }
  }
  system.rhs.assign(from.b.data(), from.b.data() + from.b.size());
  for (int j = 0; j < structure.num_blocks(); ++j) {
    const int size = structure.block_size(j);
    const int first = structure.offset[j];
    const Eigen::MatrixXd block = from.u.block(first, first, size, size);
    system.camera_diagonal.insert(system.camera_diagonal.end(), block.data(),
                                  block.data() + block.size());
  }
  return system;
}

/// S^-1 b in extended precision.
inline Eigen::VectorXd ExactSolution(const RandomSystem& system) {
  return oracle::SolveSymmetric(system.s.cast<oracle::Real>(), system.b.cast<oracle::Real>())
      .cast<double>();
}

}  // namespace bundle
