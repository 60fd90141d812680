#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <limits>
#include <new>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/gil.h"
#include "bindings/options_from_python.h"
#include "bindings/problem_from_python.h"
#include "bindings/to_numpy.h"
#include "core/error.h"
#include "core/model/coupled_blocks.h"
#include "core/prepare/prepare.h"
#include "core/symbolic/block_pattern.h"
#include "core/symbolic/factor_counts.h"
#include "core/symbolic/orderings.h"

namespace py = pybind11;

namespace {

template <typename Array>
void ExpectLength(const char* name, const Array& array, int64_t length) {
  if (array.ndim() == 1 && array.shape(0) == length) return;
  std::string found;
  for (py::ssize_t i = 0; i < array.ndim(); ++i) {
    found += (i > 0 ? " x " : "") + std::to_string(array.shape(i));
  }
  throw bundle::InputError(std::string(name) + ": expected " + std::to_string(length) +
                           " entries, found " + found);
}

/// The arrays must outlive the view. Throws InputError unless they are a valid pattern.
bundle::BlockPatternView ViewPattern(const Array<int>& sizes, const Array<int64_t>& column_begin,
                                     const Array<int>& rows) {
  if (sizes.ndim() != 1 || sizes.size() >= std::numeric_limits<int>::max()) {
    throw bundle::InputError("sizes: expected one entry per block and less than 2^31, found " +
                             std::to_string(sizes.ndim()) + " dimensions and " +
                             std::to_string(sizes.size()) + " entries");
  }
  ExpectLength("column_begin", column_begin, sizes.size() + 1);
  ExpectLength("rows", rows, column_begin.data()[sizes.size()]);
  const bundle::BlockPatternView pattern{static_cast<int>(sizes.size()), sizes.data(),
                                         column_begin.data(), rows.data()};
  const ReleaseGil release;
  bundle::CheckBlockPattern(pattern);
  return pattern;
}

template <typename T>
py::array_t<T> ToVector(std::vector<T> values) {
  const auto size = static_cast<py::ssize_t>(values.size());
  return ToNumpy(std::move(values), {size});
}

py::tuple ToTuple(bundle::BlockPattern pattern) {
  return py::make_tuple(ToVector(std::move(pattern.size)),
                        ToVector(std::move(pattern.column_begin)),
                        ToVector(std::move(pattern.row)));
}

py::array_t<int> OrderBlocks(const Array<int>& sizes, const Array<int64_t>& column_begin,
                             const Array<int>& rows, const std::string& method) {
  const bundle::OrderingMethod ordering = bundle::OrderingFromName(method);
  const bundle::BlockPatternView pattern = ViewPattern(sizes, column_begin, rows);
  std::vector<int> order;
  {
    const ReleaseGil release;
    order = bundle::FindOrder(pattern, ordering);
  }
  if (static_cast<int>(order.size()) != pattern.num_blocks) throw std::bad_alloc();
  return ToVector(std::move(order));
}

py::dict CountFactor(const Array<int>& sizes, const Array<int64_t>& column_begin,
                     const Array<int>& rows, const Array<int>& order) {
  const bundle::BlockPatternView pattern = ViewPattern(sizes, column_begin, rows);
  ExpectLength("order", order, pattern.num_blocks);
  const std::vector<int> blocks(order.data(), order.data() + order.size());
  bundle::FactorCounts counts;
  {
    const ReleaseGil release;
    bundle::CheckOrder(blocks, pattern.num_blocks);
    counts = bundle::CountFactor(pattern, blocks);
  }
  py::dict result;
  result["entries"] = counts.entries;
  result["flops"] = counts.flops;
  result["cholmod_flops"] = counts.cholmod_flops;
  result["block_entries"] = counts.block_entries;
  result["fill_edges"] = counts.fill_edges;
  result["tree_height"] = counts.tree_height;
  result["parent"] = ToVector(std::move(counts.parent));
  result["postorder"] = ToVector(std::move(counts.postorder));
  result["rows_below"] = ToVector(std::move(counts.rows_below));
  result["blocks_below"] = ToVector(std::move(counts.blocks_below));
  return result;
}

using FindPattern = bundle::BlockPattern (*)(const bundle::AdjustmentProblem&,
                                             const bundle::ParameterLayout&);

template <FindPattern kFindPattern>
py::tuple PatternOf(const py::object& problem, const py::dict& options) {
  const bundle::AdjustmentProblem view(ViewProblem(problem));
  const bundle::SolveOptions solve_options = OptionsFromPython(options);
  bundle::BlockPattern pattern;
  {
    const ReleaseGil release;
    pattern = kFindPattern(view, bundle::PrepareSolve(view, solve_options).layout);
  }
  return ToTuple(std::move(pattern));
}

py::tuple OrderedFullPattern(const py::object& problem, const py::dict& options,
                             int64_t most_entries) {
  const bundle::AdjustmentProblem view(ViewProblem(problem));
  const bundle::SolveOptions solve_options = OptionsFromPython(options);
  bundle::OrderedPattern ordered;
  {
    const ReleaseGil release;
    ordered = bundle::OrderFullPattern(view, bundle::PrepareSolve(view, solve_options).layout,
                                       most_entries);
  }
  return py::make_tuple(ToTuple(std::move(ordered.pattern)), ToVector(std::move(ordered.order)),
                        ordered.points_first);
}

}  // namespace

void BindSymbolic(py::module_& m) {
  m.def("order_blocks", &OrderBlocks, py::arg("sizes"), py::arg("column_begin"), py::arg("rows"),
        py::arg("method"));
  m.def("count_factor", &CountFactor, py::arg("sizes"), py::arg("column_begin"), py::arg("rows"),
        py::arg("order"));
  m.def("reduced_pattern", &PatternOf<&bundle::ReducedPattern>, py::arg("problem"),
        py::arg("options"));
  m.attr("MOST_ENTRIES_FOR_AMD") = bundle::kMostEntriesForAmd;
  m.def("ordered_full_pattern", &OrderedFullPattern, py::arg("problem"), py::arg("options"),
        py::arg("most_entries"));
  m.def("full_pattern", &PatternOf<&bundle::FullPattern>, py::arg("problem"), py::arg("options"));
}
