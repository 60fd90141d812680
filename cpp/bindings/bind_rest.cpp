#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <utility>
#include <vector>

#include "bindings/given_problem.h"
#include "bindings/immutable_array.h"
#include "core/covariance/rest_information.h"

namespace py = pybind11;

namespace {

/// Calls compute(view, options, kept) for a valid problem.
template <typename Compute>
auto OnProblem(const py::object& problem, const py::dict& options, const py::object& restrictions,
               const py::object& factors, const std::vector<int>& images,
               const std::vector<int>& frames, const std::vector<int>& cameras,
               const Compute& compute) {
  const bundle::KeptVariables kept{images, frames, cameras};
  return GivenProblem(problem, options, restrictions, factors)
      .Run([&](const auto& p, const auto& o) {
        return std::make_pair(compute(p, o, kept), bundle::TangentSize(kept, p));
      });
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
