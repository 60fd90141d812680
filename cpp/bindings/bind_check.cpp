#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/gil.h"
#include "bindings/options_from_python.h"
#include "bindings/problem_from_python.h"
#include "bindings/to_numpy.h"
#include "core/ceres/gradient_check.h"
#include "core/ceres/reprojection_check.h"
#include "core/checking/check_solution.h"
#include "core/checking/spot_check.h"
#include "core/error.h"
#include "core/model/gauge.h"

namespace py = pybind11;

namespace {

/// (name, constant entries), as made by python/bundle/checking/residual_blocks.py.
using PythonManifold = std::pair<std::string, std::vector<int>>;

bundle::ManifoldSpec ToSpec(const PythonManifold& manifold) {
  return {manifold.first, manifold.second};
}

std::vector<double> ToVector(const CastArray<double>& array) {
  return std::vector<double>(array.data(), array.data() + array.size());
}

/// Calls a Python function: function(blocks, jacobians wanted) returns (residual, Jacobians or
/// None), or None if it has no value. A Python exception is stored, and ends all further calls.
class PythonFunction {
 public:
  PythonFunction(py::function function, const std::vector<CastArray<double>>& blocks)
      : function_(std::move(function)) {
    for (const CastArray<double>& block : blocks) sizes_.push_back(block.size());
  }

  bool operator()(double const* const* parameters, double* residuals, double** jacobians) {
    if (error_ != nullptr) return false;
    try {
      if (PyErr_CheckSignals() != 0) throw py::error_already_set();
      py::list blocks;
      for (size_t b = 0; b < sizes_.size(); ++b)
        blocks.append(CastArray<double>(sizes_[b], parameters[b]));
      const py::object answer = function_(blocks, jacobians != nullptr);
      if (answer.is_none()) return false;
      const auto pair = py::cast<py::tuple>(answer);
      Copy(py::cast<CastArray<double>>(pair[0]), residuals);
      for (size_t b = 0; jacobians != nullptr && b < sizes_.size(); ++b) {
        if (jacobians[b] == nullptr) continue;
        Copy(py::cast<CastArray<double>>(py::cast<py::sequence>(pair[1])[b]), jacobians[b]);
      }
      return true;
    } catch (py::error_already_set& error) {
      error_ = std::make_unique<py::error_already_set>(std::move(error));
      return false;
    }
  }

  void Rethrow() {
    if (error_ != nullptr) throw py::error_already_set(std::move(*error_));
  }

 private:
  static void Copy(const CastArray<double>& from, double* to) {
    std::copy_n(from.data(), from.size(), to);
  }

  py::function function_;
  std::vector<py::ssize_t> sizes_;
  std::unique_ptr<py::error_already_set> error_;
};

bundle::FunctionAtPoint AtPoint(PythonFunction& function, int num_residuals,
                                const std::vector<CastArray<double>>& blocks,
                                const std::vector<PythonManifold>& manifolds) {
  bundle::FunctionAtPoint at;
  at.function = std::ref(function);
  at.num_residuals = num_residuals;
  for (const CastArray<double>& block : blocks) at.blocks.push_back(ToVector(block));
  for (const PythonManifold& manifold : manifolds) at.manifolds.push_back(ToSpec(manifold));
  return at;
}

py::array_t<double> ToMatrix(std::vector<double> values, py::ssize_t rows) {
  const auto columns = static_cast<py::ssize_t>(values.size()) / rows;
  return ToNumpy(std::move(values), {rows, columns});
}

py::tuple Richardson(const py::function& function, int num_residuals,
                     const std::vector<CastArray<double>>& blocks,
                     const std::vector<PythonManifold>& manifolds, std::vector<double> minuends) {
  PythonFunction python(function, blocks);
  const bundle::KnownScales known{{}, std::move(minuends)};
  bundle::ReferenceJacobians found =
      bundle::DifferentiateByRichardson(AtPoint(python, num_residuals, blocks, manifolds), known);
  python.Rethrow();
  return py::make_tuple(ToMatrix(std::move(found.ambient.values), num_residuals),
                        ToMatrix(std::move(found.ambient.uncertainty), num_residuals),
                        ToMatrix(std::move(found.tangent.values), num_residuals),
                        ToMatrix(std::move(found.tangent.uncertainty), num_residuals));
}

/// (agrees, local Jacobian, local numeric Jacobian, message); Jacobians are None if it failed.
py::tuple GradientChecker(const py::function& function, int num_residuals,
                          const std::vector<CastArray<double>>& blocks,
                          const std::vector<PythonManifold>& manifolds, double relative_precision) {
  PythonFunction python(function, blocks);
  bundle::GradientCheckerProbe probe = bundle::RunGradientChecker(
      AtPoint(python, num_residuals, blocks, manifolds), relative_precision);
  python.Rethrow();
  if (probe.local_jacobian.empty()) {
    return py::make_tuple(false, py::none(), py::none(), probe.message);
  }
  return py::make_tuple(probe.agrees, ToMatrix(std::move(probe.local_jacobian), num_residuals),
                        ToMatrix(std::move(probe.local_numeric_jacobian), num_residuals),
                        probe.message);
}

int ManifoldTangentSize(const PythonManifold& manifold, int size) {
  return bundle::ManifoldTangentSize(ToSpec(manifold), size);
}

py::array_t<double> ManifoldPlus(const PythonManifold& manifold, const CastArray<double>& x,
                                 const CastArray<double>& delta) {
  return ToNumpy(bundle::ManifoldPlus(ToSpec(manifold), ToVector(x), ToVector(delta)), {x.size()});
}

/// (analytic, reference, uncertainty, ceres: (n, 2, columns) each; rounding, counts, agrees,
/// stable: (n,))
py::tuple CheckReprojections(const py::object& problem, const Array<int64_t>& observations,
                             const Array<double>& offsets, const std::string& cheirality,
                             double relative_precision, int num_threads) {
  const bundle::AdjustmentProblem view(ViewProblem(problem));
  const py::ssize_t n = observations.size(), two = 2, columns = bundle::NumCheckedColumns(view);
  const std::vector<py::ssize_t> shape = {n, two, columns};
  py::array_t<double> analytic(shape), reference(shape), uncertainty(shape), ceres(shape);
  py::array_t<double> rounding(n);
  py::array_t<bool> counts(n), agrees(n), stable(n);
  const auto bytes = [](py::array_t<bool>& array) {
    return reinterpret_cast<uint8_t*>(array.mutable_data());
  };
  const bundle::ReprojectionCheck out{analytic.mutable_data(),
                                      reference.mutable_data(),
                                      uncertainty.mutable_data(),
                                      ceres.mutable_data(),
                                      rounding.mutable_data(),
                                      bytes(counts),
                                      bytes(agrees),
                                      bytes(stable)};
  const int64_t* indices = observations.data();
  const double* offset_data = offsets.data();
  const bundle::Cheirality named = CheiralityFromName(cheirality);
  {
    const ReleaseGil release;
    bundle::CheckReprojections(view, indices, n, offset_data, named, relative_precision,
                               num_threads, out);
  }
  return py::make_tuple(analytic, reference, uncertainty, ceres, rounding, counts, agrees, stable);
}

/// SpotCheck of a solve with these options at the problem's values, with charts turned by
/// `rotation_offsets` (num_images, 3). `lie`, unless None, gets an observation and its Jacobian (2,
/// 6 + parameters + 3, and 6 of a rolling shutter's twist), and returns the Jacobian to be claimed.
std::string SpotCheckSolution(const py::object& problem, const py::dict& options,
                              const Array<double>& rotation_offsets, const py::object& lie) {
  const bundle::AdjustmentProblem view(ViewProblem(problem));
  const bundle::SolveOptions solve_options = OptionsFromPython(options);
  bundle::FreeParameters free = bundle::SelectFreeParameters(view, solve_options);
  bundle::FixGauge(view, solve_options.gauge, &free);
  const bundle::ParameterLayout layout(view, free);
  std::vector<double> state = layout.InitialState(view);
  for (int i = 0; i < view.num_images; ++i) {
    if (layout.image_block(i) < 0) continue;  // also for images of rigs
    const bundle::CameraBlock& block = layout.blocks()[layout.image_block(i)];
    for (int k = 0; k < block.size && block.columns[k] < 3; ++k) {
      state[block.offset + k] = rotation_offsets.at(i, block.columns[k]);
    }
  }
  bundle::CameraStates states(view, layout);
  states.Update(state.data());
  const bundle::LargeVector<double> points(view.points,
                                           view.points + py::ssize_t{3} * view.num_points);
  const bundle::SolutionUnderCheck solution(view, layout, states, points, solve_options.cheirality);
  const std::vector<bundle::ObservationAtPoint> sample = solution.Sample();
  return bundle::SpotCheck(
      sample, [&](int64_t observation, const double* x, double* residual, double* jacobian) {
        if (!solution(observation, x, residual, jacobian)) return false;
        if (jacobian == nullptr || lie.is_none()) return true;
        const py::ssize_t two = 2;
        const int image = view.observation_image[observation];
        const auto size = static_cast<py::ssize_t>(
            bundle::kPoseSize + view.camera_models[view.image_camera[image]]->num_params + 3 +
            (view.HasRollingShutter(image) ? bundle::kTwistSize : 0));
        const auto claimed =
            py::cast<CastArray<double>>(lie(observation, CastArray<double>({two, size}, jacobian)));
        if (claimed.size() != two * size) {
          throw bundle::InputError("lie: expected " + std::to_string(2 * size) + " values, found " +
                                   std::to_string(claimed.size()));
        }
        std::copy_n(claimed.data(), claimed.size(), jacobian);
        return true;
      });
}

}  // namespace

void BindCheck(py::module_& m) {
  m.def("richardson_jacobian", &Richardson, py::arg("function"), py::arg("num_residuals"),
        py::arg("blocks"), py::arg("manifolds"), py::arg("minuends") = std::vector<double>());
  m.def("gradient_checker", &GradientChecker, py::arg("function"), py::arg("num_residuals"),
        py::arg("blocks"), py::arg("manifolds"), py::arg("relative_precision"));
  m.def("manifold_tangent_size", &ManifoldTangentSize, py::arg("manifold"), py::arg("size"));
  m.def("manifold_plus", &ManifoldPlus, py::arg("manifold"), py::arg("x"), py::arg("delta"));
  m.def("spot_check", &SpotCheckSolution, py::arg("problem"), py::arg("options"),
        py::arg("rotation_offsets"), py::arg("lie"));
  m.def("check_reprojections", &CheckReprojections, py::arg("problem"), py::arg("observations"),
        py::arg("offsets"), py::arg("cheirality"), py::arg("relative_precision"),
        py::arg("num_threads"));
}
