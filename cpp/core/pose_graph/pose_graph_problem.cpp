#include "core/pose_graph/pose_graph_problem.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <utility>

#include "core/interface/summary.h"
#include "core/linear/block_structure.h"
#include "core/linear/direct_solvers.h"
#include "core/minimize/damping.h"
#include "core/parallel/thread_pool.h"
#include "core/pose_graph/block_pattern_of_edges.h"
#include "core/pose_graph/edge_kernel.h"
#include "core/pose_graph/edge_places.h"
#include "core/pose_graph/kernels/edge_kernels.h"

namespace bundle {
namespace {

/// Bytes of terms that stay in a core's second cache between the two passes of a linearisation.
constexpr int64_t kBytesOfTerms = 1 << 19;
/// With fewer edges than this, weighted by the square of their coordinates, waking a thread takes
/// longer than a pass.
constexpr int64_t kWorkOfAThread = 70000;

double DotOf(const std::vector<double>& a, const std::vector<double>& b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
}

int CountThreads(int64_t num_edges, int tangent, int num_threads) {
  const int64_t worth = std::max<int64_t>(num_edges * tangent * tangent / kWorkOfAThread, 1);
  return static_cast<int>(std::min<int64_t>(EffectiveNumThreads(num_threads), worth));
}

template <typename Group>
class PoseGraphProblemOf final : public PoseGraphProblem {
  static constexpr int kSize = Group::kTangent;
  static constexpr int kAmbient = Group::kAmbient;
  using Terms = EdgeTerms<Group>;
  static constexpr int kNumbers = Terms::kNumbers;

 public:
  PoseGraphProblemOf(const PoseGraph& graph, const std::string& ordering, int num_threads,
                     const FillOrdering* known)
      : graph_(graph),
        x_(graph.poses),
        candidate_(graph.poses),
        x_records_(PoseRecords<Group>(graph.poses)),
        candidate_records_(x_records_),
        pool_(CountThreads(graph.num_edges(), kSize, num_threads)) {
    const Stopwatch symbolic;
    EdgePattern pattern = PatternOfEdges(graph, kSize, ordering, known);
    structure_ = std::move(pattern.structure);
    solver_ = MakeSparseSolver(pattern.ordering, num_threads, &structure_, &pool_);
    symbolic_time_ = symbolic.seconds();
    pose_of_ = std::move(pattern.pose_of);
    PlaceEdges(pattern.block_of);
    const size_t columns = structure_.num_columns();
    system_.values.resize(structure_.num_values);
    for (std::vector<double>* v :
         {&system_.rhs, &gradient_, &scale_, &d_squared_, &newton_, &direction_, &step_}) {
      v->resize(columns);
    }
    const int64_t at_a_time = pool_.num_threads() * kBytesOfTerms / (kNumbers * sizeof(double));
    edges_at_a_time_ = std::min<int64_t>(at_a_time, places_.size());
    terms_.resize(edges_at_a_time_ * kNumbers);
    costs_.resize(places_.size());
    state_norm_ = NormOf(x_);
  }

  Linearization Linearize(double damping) override {
    damping_ = damping;
    std::fill(system_.values.begin(), system_.values.end(), 0.0);
    std::fill(gradient_.begin(), gradient_.end(), 0.0);
    Linearization result;
    const auto num_edges = static_cast<int64_t>(places_.size());
    for (int64_t begin = 0; begin < num_edges; begin += edges_at_a_time_) {
      ThrowIfInterrupted();
      const int64_t end = std::min(num_edges, begin + edges_at_a_time_);
      pool_.Run([&](int thread) { EvaluateEdges(begin, end, thread); });
      pool_.Run([&](int thread) { Add(begin, end, thread); });
      for (int64_t k = begin; k < end; ++k) result.cost += costs_[k];
    }
    Damp(damping);
    double squared = 0;
    for (size_t c = 0; c < gradient_.size(); ++c) {
      system_.rhs[c] = -gradient_[c];
      squared += gradient_[c] * gradient_[c];
      const double size = std::abs(gradient_[c]);
      if (!(size <= result.gradient_max_norm)) result.gradient_max_norm = size;
    }
    result.gradient_norm = std::sqrt(squared);
    result.is_finite = std::isfinite(result.cost) && std::isfinite(result.gradient_norm);
    return result;
  }

  NewtonResult SolveNewton(double eta) override {
    const LinearSolution solution = solver_->Solve(&system_, scale_, eta, newton_.data());
    return {solution.status, solution.num_iterations, solution.message};
  }

  Candidate EvaluateNewtonStep() override {
    Candidate result = Evaluate(newton_);
    result.model_cost_change = 0.5 * (damping_ * Weighted(newton_) - DotOf(gradient_, newton_));
    return result;
  }

  DoglegProducts Products() override {
    for (size_t c = 0; c < direction_.size(); ++c) direction_[c] = gradient_[c] / d_squared_[c];
    DoglegProducts& p = products_;
    p.d_pp = DotOf(direction_, gradient_);
    p.d_pq = DotOf(newton_, gradient_);
    p.d_qq = Weighted(newton_);
    p.j_pp = SquaredNormAlong(direction_);
    p.j_pq = -p.d_pp - damping_ * p.d_pq;
    p.j_qq = -p.d_pq - damping_ * p.d_qq;
    return p;
  }

  Candidate EvaluateDoglegStep(double a, double b) override {
    for (size_t c = 0; c < step_.size(); ++c) step_[c] = a * direction_[c] + b * newton_[c];
    Candidate result = Evaluate(step_);
    const DoglegProducts& p = products_;
    result.model_cost_change =
        -(a * p.d_pp + b * p.d_pq) - 0.5 * (a * a * p.j_pp + 2 * a * b * p.j_pq + b * b * p.j_qq);
    return result;
  }

  void Accept() override {
    std::swap(x_, candidate_);
    std::swap(x_records_, candidate_records_);
    std::swap(state_norm_, candidate_norm_);
  }

  double StateNorm() const override { return state_norm_; }

  const std::vector<double>& poses() const override { return x_; }
  std::vector<double> Chi2() const override { return EdgeChi2AtRecords<Group>(graph_, x_records_); }
  void Restore(const std::vector<double>& poses) override {
    x_ = poses;
    x_records_ = PoseRecords<Group>(x_);
    state_norm_ = NormOf(x_);
  }
  double fixed_cost() const override { return fixed_cost_; }
  int num_free_poses() const override { return structure_.num_blocks(); }
  int64_t num_active_edges() const override { return static_cast<int64_t>(places_.size()); }
  const BlockStructure& structure() const override { return structure_; }
  const std::vector<int>& pose_of_blocks() const override { return pose_of_; }
  BlockSystem& system() override { return system_; }
  LinearSolver& solver() override { return *solver_; }
  FactorStatistics factor_statistics() const override { return solver_->factor_statistics(); }
  double symbolic_time_in_seconds() const override { return symbolic_time_; }

 private:
  void PlaceEdges(const std::vector<int>& block_of) {
    for (int64_t e = 0; e < graph_.num_edges(); ++e) {
      const EdgePlace place = FindPlace(structure_, block_of[graph_.edges()[2 * e]],
                                        block_of[graph_.edges()[2 * e + 1]]);
      if (place.i < 0 && place.j < 0) {
        double chi2;
        kernels_.chi2(graph_.Arrays(x_records_.data()), &e, 1, &chi2);
        fixed_cost_ += CostOf(e, chi2, nullptr);
        continue;
      }
      active_edges_.push_back(e);
      places_.push_back(place);
    }
  }

  /// 1/2 rho, and rho' unless nullptr.
  double CostOf(int64_t edge, double chi2, double* weight) const {
    double rho[3];
    ValueOfEdgeLoss(graph_.LossOf(edge), graph_.errors.loss_scale, chi2, rho);
    if (weight != nullptr) *weight = rho[1];
    return 0.5 * rho[0];
  }

  /// The portion of a thread in [begin, end).
  std::pair<int64_t, int64_t> Share(int64_t begin, int64_t end, int thread) const {
    const int64_t count = end - begin, threads = pool_.num_threads();
    return {begin + count * thread / threads, begin + count * (thread + 1) / threads};
  }

  void EvaluateEdges(int64_t begin, int64_t end, int thread) {
    const auto [first, last] = Share(begin, end, thread);
    double* terms = terms_.data() + (first - begin) * kNumbers;
    kernels_.linearize(graph_.Arrays(x_records_.data()), active_edges_.data() + first, last - first,
                       terms);
    for (int64_t k = first; k < last; ++k, terms += kNumbers) {
      double weight;
      costs_[k] = CostOf(active_edges_[k], terms[Terms::kChi2], &weight);
      if (weight == 1) continue;
      for (int i = 0; i < kNumbers; ++i) terms[i] *= weight;
    }
  }

  void Add(int64_t begin, int64_t end, int thread) {
    const auto [first, last] = Share(0, structure_.num_blocks(), thread);
    const double* terms = terms_.data();
    for (int64_t k = begin; k < end; ++k, terms += kNumbers) {
      AddEdge<Group>(structure_, places_[k], terms, static_cast<int>(first), static_cast<int>(last),
                     system_.values.data(), gradient_.data());
    }
  }

  void Damp(double damping) {
    for (int b = 0; b < structure_.num_blocks(); ++b) {
      double* const block = system_.values.data() + DiagonalIndex(structure_, b);
      const int64_t stride = structure_.panel_stride[b] + 1;
      for (int c = 0; c < kSize; ++c) {
        const size_t k = size_t{kSize} * b + c;
        double& entry = block[c * stride];
        if (!is_scaled_) scale_[k] = JacobiScale(entry);
        d_squared_[k] = SquaredDamping(entry, scale_[k]);
        entry += damping * d_squared_[k];
      }
    }
    is_scaled_ = true;
  }

  /// d^T D^2 d
  double Weighted(const std::vector<double>& d) const {
    double sum = 0;
    for (size_t c = 0; c < d.size(); ++c) sum += d[c] * d[c] * d_squared_[c];
    return sum;
  }

  /// ||J d||^2 at x, losses included.
  double SquaredNormAlong(const std::vector<double>& d) {
    std::vector<double> parts(places_.size());
    ForEdges([&](int64_t k) {
      const EdgePlace& place = places_[k];
      double residual[kSize], a[kSize * kSize], adjoint[kSize * kSize], moved[kSize] = {}, rho[3];
      EvaluateWhitened<Group>(graph_, active_edges_[k], x_records_.data(), residual, a, adjoint);
      ValueOfEdgeLoss(graph_.LossOf(active_edges_[k]), graph_.errors.loss_scale,
                      SquaredNorm(residual, kSize), rho);
      for (int r = 0; r < kSize; ++r) {
        if (place.j >= 0) moved[r] = d[int64_t{kSize} * place.j + r];
        for (int c = 0; place.i >= 0 && c < kSize; ++c) {
          moved[r] -= adjoint[r * kSize + c] * d[int64_t{kSize} * place.i + c];
        }
      }
      for (int r = 0; r < kSize; ++r) {
        double row = 0;
        for (int c = 0; c < kSize; ++c) row += a[r * kSize + c] * moved[c];
        parts[k] += rho[1] * row * row;
      }
    });
    double sum = 0;
    for (const double part : parts) sum += part;
    return sum;
  }

  template <typename Visit>
  void ForEdges(const Visit& visit) {
    ThrowIfInterrupted();
    pool_.Run([&](int thread) {
      const auto [first, last] = Share(0, places_.size(), thread);
      for (int64_t k = first; k < last; ++k) visit(k);
    });
  }

  /// The candidate X Exp(d).
  Candidate Evaluate(const std::vector<double>& d) {
    pool_.Run([&](int thread) {
      const auto [first, last] = Share(0, structure_.num_blocks(), thread);
      for (int64_t b = first; b < last; ++b) {
        const int64_t pose = pose_of_[b];
        Group::Move(x_records_.data() + pose * Group::kRecord, d.data() + b * kSize,
                    candidate_.data() + pose * kAmbient,
                    candidate_records_.data() + pose * Group::kRecord);
      }
    });
    ThrowIfInterrupted();
    pool_.Run([&](int thread) {
      const auto [first, last] = Share(0, places_.size(), thread);
      kernels_.chi2(graph_.Arrays(candidate_records_.data()), active_edges_.data() + first,
                    last - first, costs_.data() + first);
      for (int64_t k = first; k < last; ++k) {
        costs_[k] = CostOf(active_edges_[k], costs_[k], nullptr);
      }
    });
    Candidate result;
    for (const double cost : costs_) result.cost += cost;
    result.step_norm = std::sqrt(DotOf(d, d));
    candidate_norm_ = NormOf(candidate_);
    return result;
  }

  double NormOf(const std::vector<double>& poses) const {
    double sum = 0;
    for (const int pose : pose_of_) {
      for (int k = 0; k < kAmbient; ++k) {
        const double value = poses[int64_t{pose} * kAmbient + k];
        sum += value * value;
      }
    }
    return std::sqrt(sum);
  }

  const PoseGraph& graph_;
  const EdgeKernels<Group>& kernels_ = SelectEdgeKernels<Group>();
  std::vector<double> x_, candidate_;
  std::vector<double> x_records_, candidate_records_;  ///< relative_pose.h
  ThreadPool pool_;
  BlockStructure structure_;
  std::unique_ptr<LinearSolver> solver_;
  double symbolic_time_ = 0;
  std::vector<int> pose_of_;  ///< pose per block
  std::vector<EdgePlace> places_;
  std::vector<int64_t> active_edges_;  ///< edge per place
  double fixed_cost_ = 0;
  BlockSystem system_;
  std::vector<double> gradient_, scale_, d_squared_, newton_, direction_, step_;
  int64_t edges_at_a_time_ = 0;
  ArenaVector<double> terms_;
  std::vector<double> costs_;
  DoglegProducts products_;
  double damping_ = 0;
  double state_norm_ = 0, candidate_norm_ = 0;
  bool is_scaled_ = false;
};

}  // namespace

std::unique_ptr<PoseGraphProblem> MakePoseGraphProblem(const PoseGraph& graph,
                                                       const std::string& ordering, int num_threads,
                                                       const FillOrdering* known) {
  if (graph.dimension() == 2) {
    return std::make_unique<PoseGraphProblemOf<Se2>>(graph, ordering, num_threads, known);
  }
  return std::make_unique<PoseGraphProblemOf<Se3>>(graph, ordering, num_threads, known);
}

}  // namespace bundle
