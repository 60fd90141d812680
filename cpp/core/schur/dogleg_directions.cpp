/// The two directions of a dogleg, of all points and unknowns, and their products.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "core/parallel/reducer.h"
#include "core/schur/for_chunks.h"
#include "core/schur/newton_gauge.h"
#include "core/schur/schur_problem.h"

namespace bundle {

DoglegProducts SchurProblem::Products() {
  gradient_direction_.resize(newton_.size());
  for (size_t j = 0; j < newton_.size(); ++j) {
    gradient_direction_[j] = gradient()[j] / d_squared_[j];
  }
  points_p_.resize(x_->points.size());
  points_q_.resize(x_->points.size());
  if (gauge_degrees_ < 0) gauge_degrees_ = NewtonGauge::Degrees(problem_, layout_, plan_);
  if (gauge_degrees_ > 0) points_d_squared_.resize(x_->points.size());
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
  for (const ProductSum& part : parts) {
    total.d_pp += part.d_pp, total.d_pq += part.d_pq, total.d_qq += part.d_qq;
    total.j_pp += part.j_pp, total.j_pq += part.j_pq, total.j_qq += part.j_qq;
  }
  factors_.AddProducts(gradient_direction_, newton_, &total);
  SumOverRanks(ranks_,
               {&total.d_pp, &total.d_pq, &total.d_qq, &total.j_pp, &total.j_pq, &total.j_qq});
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
  for (const NewtonGauge::Sums& part : parts) total.Add(part);
  std::vector<double> sums(total.square.data(), total.square.data() + total.square.size());
  sums.insert(sums.end(), total.product.data(), total.product.data() + total.product.size());
  SumOverRanks(ranks_, "gauge", &sums);
  std::copy_n(sums.data(), total.square.size(), total.square.data());
  std::copy_n(sums.data() + total.square.size(), total.product.size(), total.product.data());
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
