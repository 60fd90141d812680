/// Part of SchurProblem (schur_problem.h): gradient and Newton direction for doglegs, and their
/// inner products.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "core/schur/for_chunks.h"
#include "core/schur/newton_gauge.h"
#include "core/schur/schur_problem.h"
#include "core/sums/communicator.h"

namespace bundle {

namespace {

constexpr int kNumProducts = 6;

void AddProducts(double d_pp, double d_pq, double d_qq, double j_pp, double j_pq, double j_qq,
                 DoubleDouble sums[kNumProducts]) {
  const double products[kNumProducts] = {d_pp, d_pq, d_qq, j_pp, j_pq, j_qq};
  for (int k = 0; k < kNumProducts; ++k) sums[k].Add(products[k]);
}

}  // namespace

DoglegProducts SchurProblem::Products() {
  gradient_direction_.resize(newton_.size());
  for (size_t j = 0; j < newton_.size(); ++j) {
    gradient_direction_[j] = gradient()[j] / d_squared_[j];
  }
  points_p_.resize(x_->points.size(), 0.0);
  points_q_.resize(x_->points.size(), 0.0);
  if (gauge_degrees_ < 0) gauge_degrees_ = NewtonGauge::Degrees(problem_, layout_, plan_);
  if (gauge_degrees_ > 0) points_d_squared_.resize(x_->points.size(), 0.0);
  step_.Set(gradient_direction_, x_->cameras());
  other_step_.Set(newton_, x_->cameras());
  DoglegProducts total;
  std::vector<ProductSum> parts(plan_.chunks.size());
  ForChunks([&](int c, int thread) {
    kernels_.products(input_, x_->records(), plan_.chunks[c], damping_, squared_scale_.data(),
                      step_.records(), other_step_.records(), points_p_.data(), points_q_.data(),
                      gauge_degrees_ > 0 ? points_d_squared_.data() : nullptr, Memory(thread),
                      &parts[c]);
  });
  DoubleDouble sums[kNumProducts];
  for (const ProductSum& part : parts) {
    AddProducts(part.d_pp, part.d_pq, part.d_qq, part.j_pp, part.j_pq, part.j_qq, sums);
  }
  factors_.AddProducts(gradient_direction_, newton_, &total);
  AddProducts(total.d_pp, total.d_pq, total.d_qq, total.j_pp, total.j_pq, total.j_qq, sums);
  RoundOverRanks(communicator_, {&sums[0], &sums[1], &sums[2], &sums[3], &sums[4], &sums[5]});
  total = {sums[0].sum, sums[1].sum, sums[2].sum, sums[3].sum, sums[4].sum, sums[5].sum};
  for (size_t j = 0; j < newton_.size(); ++j) {
    const double p = gradient_direction_[j], q = newton_[j];
    total.d_pp += p * d_squared_[j] * p;
    total.d_pq += p * d_squared_[j] * q;
    total.d_qq += q * d_squared_[j] * q;
  }
  if (gauge_degrees_ > 0) total.d_qq -= TakeOutGauge();
  products_ = total;
  return total;
}

double SchurProblem::TakeOutGauge() {
  const NewtonGauge gauge(problem_, layout_, gauge_degrees_, x_->cameras(), x_->points);
  const auto range = [&](int c) {
    const Chunk& chunk = plan_.chunks[c];
    const int last = chunk.first_row > 0 ? chunk.first_point : chunk.last_point;
    return std::pair(chunk.first_point, last);
  };
  std::vector<NewtonGauge::Sums> parts(plan_.chunks.size());
  ForChunks([&](int c, int) {
    const auto [begin, end] = range(c);
    gauge.AddPoints(begin, end, points_d_squared_, points_q_, &parts[c]);
  });
  NewtonGauge::Sums total;
  const auto num_squares = static_cast<size_t>(total.square.size());
  std::vector<DoubleDouble> exact(num_squares + static_cast<size_t>(total.product.size()));
  for (const NewtonGauge::Sums& part : parts) {
    for (size_t k = 0; k < exact.size(); ++k) {
      exact[k].Add(k < num_squares ? part.square.data()[k] : part.product.data()[k - num_squares]);
    }
  }
  const std::vector<double> sums = RoundOverRanks(communicator_, "gauge", exact);
  std::copy_n(sums.data(), num_squares, total.square.data());
  std::copy_n(sums.data() + num_squares, total.product.size(), total.product.data());
  for (size_t j = 0; j < newton_.size(); ++j) {
    total.Add(gauge.OfUnknown(j), d_squared_[j], newton_[j]);
  }
  const NewtonGauge::Row k = gauge.Solve(total);
  for (size_t j = 0; j < newton_.size(); ++j) newton_[j] -= gauge.OfUnknown(j).dot(k);
  ForChunks([&](int c, int) {
    const auto [begin, end] = range(c);
    for (int point = begin; point < end; ++point) {
      Eigen::Map<Eigen::Vector3d>(&points_q_[3 * size_t(point)]) -= gauge.MoveOfPoint(point, k);
    }
  });
  return total.product.dot(k);
}

}  // namespace bundle
