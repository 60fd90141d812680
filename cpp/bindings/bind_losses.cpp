#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <string>

#include "bindings/arrays.h"
#include "bindings/options_from_python.h"
#include "core/ceres/losses.h"
#include "core/factors/loss.h"

namespace py = pybind11;

namespace {

Array<double> EvaluateLoss(const std::string& loss, double scale,
                           const Array<double>& squared_norms) {
  const py::ssize_t n = squared_norms.size();
  Array<double> values({n, py::ssize_t{3}});
  bundle::EvaluateLoss(LossFromName(loss), scale, n, squared_norms.data(), values.mutable_data());
  return values;
}

/// Returns the corrected (residual, jacobian), or None if no correction exists.
py::object Correct(const Array<double>& rho, const Array<double>& residual,
                   const Array<double>& jacobian, const std::string& second_order_term) {
  const int rows = static_cast<int>(jacobian.shape(0));
  const int columns = static_cast<int>(jacobian.shape(1));
  Array<double> r(residual.request());
  Array<double> j(jacobian.request());
  if (second_order_term == "ceres") {
    bundle::CorrectWithCeres(rho.data(), rows, columns, r.mutable_data(), j.mutable_data());
    return py::make_tuple(r, j);
  }
  const auto correction =
      bundle::SolveTriggs(rho.data(), bundle::SquaredNorm(residual.data(), rows),
                          second_order_term == "full" ? bundle::SecondOrderTerm::kFull
                                                      : bundle::SecondOrderTerm::kClamped);
  if (!correction) return py::none();
  bundle::ApplyTriggs(*correction, rows, columns, r.mutable_data(), j.mutable_data());
  return py::make_tuple(r, j);
}

Array<double> SecondOrderBlock(const Array<double>& rho, const Array<double>& residual,
                               const Array<double>& jacobian) {
  const int columns = static_cast<int>(jacobian.shape(1));
  Array<double> block({columns, columns});
  bundle::SecondOrderBlock(rho.data(), static_cast<int>(jacobian.shape(0)), columns,
                           residual.data(), jacobian.data(), block.mutable_data());
  return block;
}

}  // namespace

void BindLosses(py::module_& m) {
  m.def("evaluate_loss", &EvaluateLoss, py::arg("loss"), py::arg("scale"),
        py::arg("squared_norms"));
  m.def("correct", &Correct, py::arg("rho"), py::arg("residual"), py::arg("jacobian"),
        py::arg("second_order_term"));
  m.def("second_order_block", &SecondOrderBlock, py::arg("rho"), py::arg("residual"),
        py::arg("jacobian"));
}
