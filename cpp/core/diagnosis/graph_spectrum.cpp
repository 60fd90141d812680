#include "core/diagnosis/graph_spectrum.h"

/// H = J^T W J of the free poses, as in a solve, and S = D H D with ones on its diagonal. The
/// largest eigenvalue is computed by products, the smallest by products with the inverse
/// (krylov.h), which is accurate for any size. If edges leave directions undetermined, these are
/// projected out, and a small shift of the diagonal makes the factorisation possible:
///
///   P (S + shift)^-1 P,    P = I - Z Z^T,
///
/// with Z an orthonormal basis of these directions in the units of S. The same is valid for the
/// unscaled H, whose inverse is D S^-1 D.

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "core/dense/decompositions.h"
#include "core/dense/krylov.h"
#include "core/error.h"
#include "core/linear/symmetric_product.h"
#include "core/pose_graph/pose_graph_problem.h"

namespace bundle {
namespace {

constexpr double kGraphShift = 1e-12;
constexpr int kGraphModes = 4;
constexpr double kEnough = 1e-4;
/// Maximum numbers in a basis; twice as many are stored, because its image is stored, too.
constexpr int64_t kBasisNumbers = 20'000'000;

class GraphSpectrumSearch {
 public:
  GraphSpectrumSearch(const PoseGraph& graph, int num_threads)
      : problem_(MakePoseGraphProblem(graph, "auto", num_threads)) {
    problem_->Linearize(0);
    const BlockStructure& s = problem_->structure();
    compact_ = CompactStructure(s);
    values_.assign(compact_.num_values, 0.0);
    AddBlocks(s, problem_->system().values.data(), compact_, values_.data());
    product_ = std::make_unique<SymmetricProduct>(compact_, num_threads);
    d_.resize(s.num_columns());
    s.ForDiagonal([&](int column, int64_t at) {
      const double entry = problem_->system().values[at];
      d_[column] = entry > 0 ? 1 / std::sqrt(entry) : 1;
    });
  }

  GraphSpectrum Run(const Eigen::MatrixXd& open) {
    const int size = static_cast<int>(d_.size());
    GraphSpectrum found;
    Factorize(open.cols() > 0);
    const Eigen::VectorXd inverse = d_.cwiseInverse();
    const Eigen::MatrixXd nothing(size, 0);
    const Eigen::MatrixXd z = Orthonormalize(nothing, open);
    const Eigen::MatrixXd scaled_z = Orthonormalize(nothing, inverse.asDiagonal() * open);
    const int wanted = std::min<int>(kGraphModes, size - static_cast<int>(z.cols()));
    if (wanted <= 0) {
      found.condition_number = found.condition_number_unscaled =
          std::numeric_limits<double>::quiet_NaN();
      return found;
    }
    const auto without = [](const Eigen::MatrixXd& basis, Eigen::MatrixXd x) {
      for (int twice = 0; twice < 2 && basis.cols() > 0; ++twice) {
        x -= bundle::Multiply(basis, MultiplyTransposed(basis, x));
      }
      return x;
    };
    found.max_eigenvalue = Largest(1, [&](const Eigen::MatrixXd& x) {
                             return Eigen::MatrixXd(d_.asDiagonal() * Product(d_.asDiagonal() * x));
                           }).front();
    const double highest = Largest(1, [&](const Eigen::MatrixXd& x) { return Product(x); }).front();
    for (const double value : Largest(wanted, [&](const Eigen::MatrixXd& x) {
           const Eigen::MatrixXd solved = Solve(inverse.asDiagonal() * without(scaled_z, x));
           return without(scaled_z, inverse.asDiagonal() * solved);
         })) {
      found.eigenvalues.push_back(1 / value);
    }
    const double lowest = 1 / Largest(1, [&](const Eigen::MatrixXd& x) {
                                return without(z, Solve(without(z, x)));
                              }).front();
    found.condition_number = found.max_eigenvalue / found.eigenvalues.front();
    found.condition_number_unscaled = highest / lowest;
    return found;
  }

  const std::vector<int>& pose_of_blocks() const { return problem_->pose_of_blocks(); }

 private:
  void Factorize(bool shifted) {
    BlockSystem& system = problem_->system();
    const BlockStructure& s = problem_->structure();
    for (double shift : {shifted ? kGraphShift : 0.0, 1e-10, 1e-8}) {
      std::fill(system.values.begin(), system.values.end(), 0.0);
      AddBlocks(compact_, values_.data(), s, system.values.data());
      s.ForDiagonal(
          [&](int column, int64_t at) { system.values[at] += shift / (d_[column] * d_[column]); });
      if (problem_->solver().Factorize(&system, {}).status == LinearStatus::kSuccess) {
        return;
      }
    }
    throw InputError(
        "graph: expected normal equations that can be factorised, found numbers that are too "
        "large or too small");
  }

  Eigen::MatrixXd Product(const Eigen::MatrixXd& x) {
    Eigen::MatrixXd y(x.rows(), x.cols());
    for (Eigen::Index k = 0; k < x.cols(); ++k) {
      product_->Multiply(values_, x.col(k).data(), y.col(k).data());
    }
    return y;
  }

  Eigen::MatrixXd Solve(const Eigen::MatrixXd& x) {
    Eigen::MatrixXd y(x.rows(), x.cols());
    problem_->solver().Solve(x.data(), static_cast<int>(x.cols()), 0, y.data());
    return y;
  }

  /// NaN for an operator that is 0 or has no finite product.
  std::vector<double> Largest(int wanted, const BlockOperator& apply) const {
    const auto size = static_cast<int>(d_.size());
    const auto most = static_cast<int>(std::clamp<int64_t>(kBasisNumbers / size, 24, 160));
    std::vector<double> found =
        FindLargest(size, wanted, std::max(2, wanted), most, kEnough, apply).values;
    if (found.empty()) found.push_back(std::numeric_limits<double>::quiet_NaN());
    return found;
  }

  const std::unique_ptr<PoseGraphProblem> problem_;
  BlockStructure compact_;
  BlockValues values_;
  std::unique_ptr<SymmetricProduct> product_;
  Eigen::VectorXd d_;
};

}  // namespace

GraphSpectrum FindGraphSpectrum(const PoseGraph& graph, const double* null_directions, int num_null,
                                int num_threads) {
  GraphSpectrumSearch search(graph, num_threads);
  const int tangent = TangentSize(graph.dimension());
  const std::vector<int>& poses = search.pose_of_blocks();
  Eigen::MatrixXd open(static_cast<Eigen::Index>(poses.size()) * tangent, num_null);
  for (size_t b = 0; b < poses.size(); ++b) {
    for (int r = 0; r < tangent; ++r) {
      for (int k = 0; k < num_null; ++k) {
        open(static_cast<Eigen::Index>(b) * tangent + r, k) =
            null_directions[(int64_t{poses[b]} * tangent + r) * num_null + k];
      }
    }
  }
  return search.Run(open);
}

}  // namespace bundle
