#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/given_problem.h"
#include "bindings/immutable_array.h"
#include "core/diagnosis/reduced_spectrum.h"
#include "core/model/unknown_names.h"

namespace py = pybind11;

namespace {

py::dict ReducedSpectrum(const py::object& problem, const py::dict& options,
                         const Array<int32_t>& image_piece, const py::object& restrictions,
                         const py::object& factors, int num_modes) {
  GivenProblem given(problem, options, restrictions, factors);
  bundle::ReducedSpectrum found = given.Run([&](const auto& p, const auto& o) {
    return bundle::FindReducedSpectrum(p, o, image_piece.data(), num_modes);
  });

  std::vector<int32_t> unknowns, null_points;
  for (const bundle::UnknownName& name : found.unknowns) {
    unknowns.insert(unknowns.end(), {name.kind, name.index, name.coordinate});
  }
  for (const bundle::NullPoint& null : found.null_points) null_points.push_back(null.point);
  const auto count = [](const auto& v) { return static_cast<py::ssize_t>(v.size()); };
  const py::ssize_t num_unknowns = count(found.unknowns), num_null_points = count(null_points),
                    num_modes_found = count(found.eigenvalues);
  py::dict d;
  d["unknowns"] = ToImmutableNumpy(std::move(unknowns), {num_unknowns, 3});
  d["scale"] = ToImmutableNumpy(std::move(found.scale), {num_unknowns});
  d["unseen"] = ToImmutableNumpy(std::move(found.unseen), {num_unknowns});
  d["null_points"] = ToImmutableNumpy(std::move(null_points), {num_null_points});
  d["null_directions"] =
      ToImmutableNumpy(std::move(found.null_directions), {num_unknowns, found.num_null_directions});
  d["eigenvalues"] = ToImmutableNumpy(std::move(found.eigenvalues), {num_modes_found});
  d["directions"] = ToImmutableNumpy(std::move(found.directions), {num_unknowns, num_modes_found});
  py::list warnings;
  for (const bundle::Warning& warning : found.warnings) {
    warnings.append(
        py::make_tuple(bundle::NameOf(warning.kind, bundle::kWarningKinds), warning.text));
  }
  d["warnings"] = warnings;
#define BUNDLE_FIELD(name) d[#name] = found.name
  BUNDLE_FIELD(expected_nullity);
  BUNDLE_FIELD(nullity);
  BUNDLE_FIELD(num_gauge);
  BUNDLE_FIELD(nullity_is_exact);
  BUNDLE_FIELD(max_null_eigenvalue);
  BUNDLE_FIELD(max_eigenvalue);
  BUNDLE_FIELD(condition_number_unscaled);
  BUNDLE_FIELD(failure);
  BUNDLE_FIELD(failed_unknown);
#undef BUNDLE_FIELD
  if (found.failed_unknown >= 0) {
    d["failed_name"] = bundle::Words(given.view(), found.unknowns[found.failed_unknown]);
  }
  return d;
}

}  // namespace

void BindDiagnosis(py::module_& m) {
  m.def("reduced_spectrum", &ReducedSpectrum, py::arg("problem"), py::arg("options"),
        py::arg("image_piece"), py::arg("restrictions") = py::none(),
        py::arg("factors") = py::none(), py::arg("num_modes") = 8);
}
