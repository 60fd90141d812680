#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <string>

#include "bindings/options_from_python.h"
#include "core/ceres/losses.h"
#include "core/factors/loss.h"

namespace py = pybind11;

namespace {

using Array = py::array_t<double, py::array::c_style>;

Array EvaluateLoss(const std::string& loss, double scale, const Array& squared_norms) {
  const py::ssize_t n = squared_norms.size();
  Array values({n, py::ssize_t{3}});
  bundle::EvaluateLoss(LossFromName(loss), scale, n, squared_norms.data(), values.mutable_data());
  return values;
}

/// Returns the corrected (residual, jacobian), or None if no correction exists.
py::object Correct(const Array& rho, const Array& residual, const Array& jacobian,
                   const std::string& second_order_term) {
  const int rows = static_cast<int>(jacobian.shape(0));
  const int columns = static_cast<int>(jacobian.shape(1));
  Array r(residual.request());
  Array j(jacobian.request());
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

Array SecondOrderBlock(const Array& rho, const Array& residual, const Array& jacobian) {
  const int columns = static_cast<int>(jacobian.shape(1));
  Array block({columns, columns});
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
