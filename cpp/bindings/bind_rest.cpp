#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <utility>
#include <vector>

#include "bindings/given_factors.h"
#include "bindings/immutable_array.h"
#include "bindings/options_from_python.h"
#include "bindings/problem_from_python.h"
#include "bindings/python_progress.h"
#include "core/covariance/rest_information.h"

namespace py = pybind11;

namespace {

/// Calls compute(view, options, kept) for a valid problem.
template <typename Compute>
auto OnProblem(const py::object& problem, const py::dict& options, const py::object& restrictions,
               const py::object& given_factors, const std::vector<int>& images,
               const std::vector<int>& frames, const std::vector<int>& cameras,
               const Compute& compute) {
  bundle::AdjustmentProblem view(ViewProblem(problem));
  view.restrictions = ViewRestrictions(restrictions, view);
  GivenFactors factors(given_factors);
  const bundle::SolveOptions solve_options = OptionsFromPython(options);
  const bundle::KeptVariables kept{images, frames, cameras};
  PythonProgress watch{py::none()};
  auto output = RunWatched(&watch, [&] {
    bundle::ValidateProblem(view);
    view.factors = factors.Check();
    return std::make_pair(compute(view, solve_options, kept), bundle::TangentSize(kept, view));
  });
  watch.Rethrow();
  return output;
}

py::dict MarginalizeRest(const py::object& problem, const py::dict& options,
                         const py::object& restrictions, const py::object& factors,
                         const std::vector<int>& images, const std::vector<int>& frames,
                         const std::vector<int>& cameras) {
  auto [output, size] = OnProblem(problem, options, restrictions, factors, images, frames, cameras,
                                  bundle::MarginalizeRest);
  py::dict d;
  d["lambda"] = ToImmutableNumpy(std::move(output.lambda), {size, size});
  d["eta"] = ToImmutableNumpy(std::move(output.eta), {size});
  d["num_eliminated"] = output.num_eliminated;
  d["num_points"] = output.num_points;
  d["num_null_points"] = output.num_null_points;
  d["is_regular"] = output.is_regular;
  return d;
}

py::object FindFreeSimilarities(const py::object& problem, const py::dict& options,
                                const py::object& restrictions, const py::object& factors,
                                const std::vector<int>& images, const std::vector<int>& frames,
                                const std::vector<int>& cameras) {
  auto [output, size] = OnProblem(problem, options, restrictions, factors, images, frames, cameras,
                                  bundle::FindFreeSimilarities);
  return ToImmutableNumpy(std::move(output.rows), {size, output.degrees});
}

}  // namespace

void BindRest(py::module_& m) {
  m.def("marginalize_rest", &MarginalizeRest, py::arg("problem"), py::arg("options"),
        py::arg("restrictions"), py::arg("factors"), py::arg("images"), py::arg("frames"),
        py::arg("cameras"));
  m.def("free_similarities", &FindFreeSimilarities, py::arg("problem"), py::arg("options"),
        py::arg("restrictions"), py::arg("factors"), py::arg("images"), py::arg("frames"),
        py::arg("cameras"));
}
