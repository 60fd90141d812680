#pragma once

/// Lets bundle.check_gradients, in Python, check the Jacobians of compiled ceres cost functions.
///
/// A module of your own hands them over. It needs Ceres, pybind11 and C++17; of bundle there is
/// nothing to link:
///
///   #include <bundle/checkable.h>
///
///   PYBIND11_MODULE(costs, m) {
///     m.def("reprojection", [](double x, double y) {
///       return bundle::Checkable(std::make_unique<ReprojectionCost>(x, y));
///     });
///   }
///
/// A test is then one line of Python:
///
///   assert bundle.check_gradients(costs.reprojection(320, 240), [pose, point], ["se3", None])
///
/// `python -c "import bundle; print(bundle.get_include())"` prints the folder to compile with. The
/// folder examples/check_cost_function of bundle's sources is a whole project with CMake.

#include <ceres/cost_function.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace bundle {
namespace check_internal {

using Array = pybind11::array_t<double, pybind11::array::c_style | pybind11::array::forcecast>;

[[noreturn]] inline void ThrowInputError(const std::string& message) {
  const pybind11::object type = pybind11::module_::import("bundle").attr("InputError");
  PyErr_SetString(type.ptr(), message.c_str());
  throw pybind11::error_already_set();
}

/// One array a parameter block, each of the size that the cost function reads.
inline std::vector<Array> ToBlocks(const ceres::CostFunction& cost,
                                   const pybind11::sequence& given) {
  const auto& sizes = cost.parameter_block_sizes();
  if (given.size() != sizes.size()) {
    ThrowInputError("cost function: expected " + std::to_string(sizes.size()) +
                    " parameter blocks, found " + std::to_string(given.size()));
  }
  std::vector<Array> blocks;
  for (size_t b = 0; b < sizes.size(); ++b) {
    const pybind11::object item = given[b];
    Array block = Array::ensure(item);
    if (!block || block.size() != sizes[b]) {
      ThrowInputError("cost function: expected block " + std::to_string(b) + " to have " +
                      std::to_string(sizes[b]) + " parameters, found " +
                      (block ? std::to_string(block.size()) : "no numbers"));
    }
    blocks.push_back(std::move(block));
  }
  return blocks;
}

/// Not a number until written, so that an entry that the cost function forgets shows.
inline Array Unwritten(const std::vector<pybind11::ssize_t>& shape) {
  Array array(shape);
  std::fill_n(array.mutable_data(), array.size(), std::numeric_limits<double>::quiet_NaN());
  return array;
}

/// (residuals (R,), list of Jacobians (R, size of the block)); residuals that are not a number
/// where Evaluate returns false.
inline pybind11::tuple Evaluate(const ceres::CostFunction& cost, const pybind11::sequence& given) {
  const std::vector<Array> blocks = ToBlocks(cost, given);
  const pybind11::ssize_t num_residuals = cost.num_residuals();
  Array residuals = Unwritten({num_residuals});
  pybind11::list jacobians;
  std::vector<const double*> parameters;
  std::vector<double*> jacobian_data;
  for (const Array& block : blocks) {
    Array jacobian = Unwritten({num_residuals, block.size()});
    parameters.push_back(block.data());
    jacobian_data.push_back(jacobian.mutable_data());
    jacobians.append(std::move(jacobian));
  }
  if (!cost.Evaluate(parameters.data(), residuals.mutable_data(), jacobian_data.data())) {
    residuals = Unwritten({num_residuals});
  }
  return pybind11::make_tuple(std::move(residuals), std::move(jacobians));
}

}  // namespace check_internal

/// Returns the cost function as bundle.check_gradients takes it: a Python function of a list of
/// arrays, one a parameter block, that answers with (residuals, list of Jacobians).
///
/// Points at which Evaluate returns false are skipped by the check. Exceptions of Evaluate come
/// through it, as pybind11 translates them; bundle.InputError if the blocks are not those of the
/// cost function. Evaluate is called with Python's lock held, from one thread at a time.
inline pybind11::cpp_function Checkable(std::shared_ptr<const ceres::CostFunction> cost) {
  if (cost == nullptr) check_internal::ThrowInputError("expected a cost function, found nullptr");
  return pybind11::cpp_function(
      [cost](const pybind11::sequence& blocks) { return check_internal::Evaluate(*cost, blocks); },
      pybind11::arg("blocks"));
}

}  // namespace bundle
