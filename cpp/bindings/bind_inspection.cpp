#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/gil.h"
#include "bindings/options_from_python.h"
#include "bindings/problem_from_python.h"
#include "bindings/to_numpy.h"
#include "core/interface/options.h"
#include "core/prepare/choose_solver.h"
#include "core/prepare/memory.h"
#include "core/prepare/panel_work.h"
#include "core/prepare/prepare.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/schur_setup.h"
#include "core/symbolic/block_pattern.h"

namespace py = pybind11;

namespace {

/// The blocks that the options leave free, which form a solver's unknowns.
py::dict ParameterBlocks(const py::object& problem, const py::dict& options) {
  const bundle::AdjustmentProblem view(ViewProblem(problem));
  const bundle::PreparedSolve prepared = bundle::PrepareSolve(view, OptionsFromPython(options));
  const bundle::ParameterLayout& layout = prepared.layout;
  std::vector<int> sizes, image_block, sensor_block, camera_block;
  for (const bundle::CameraBlock& block : layout.blocks()) sizes.push_back(block.size);
  for (int i = 0; i < view.num_images; ++i) {
    image_block.push_back(layout.blocks_of(i)[bundle::ParameterLayout::kPoseBlock]);
    sensor_block.push_back(layout.blocks_of(i)[bundle::ParameterLayout::kSensorBlock]);
  }
  for (int c = 0; c < view.num_cameras; ++c) camera_block.push_back(layout.camera_block(c));
  py::array_t<bool> free_points(view.num_points);
  for (int p = 0; p < view.num_points; ++p) {
    free_points.mutable_data()[p] = layout.point_is_free(p);
  }
  const auto count = [](const auto& v) { return static_cast<py::ssize_t>(v.size()); };
  py::dict d;
  d["size"] = ToNumpy(std::move(sizes), {count(layout.blocks())});
  d["image_block"] = ToNumpy(std::move(image_block), {view.num_images});
  d["sensor_block"] = ToNumpy(std::move(sensor_block), {view.num_images});
  d["camera_block"] = ToNumpy(std::move(camera_block), {view.num_cameras});
  d["point_is_free"] = free_points;
  return d;
}

/// The fused backend's passes over the points: bundle::PlanSize.
py::dict EliminationPlan(const py::object& problem, const py::dict& options) {
  const bundle::AdjustmentProblem view(ViewProblem(problem));
  const bundle::SolveOptions solve_options = OptionsFromPython(options);
  bundle::PlanSize size;
  {
    const ReleaseGil release;
    const bundle::PreparedSolve prepared = bundle::PrepareSolve(view, solve_options);
    size = bundle::MeasurePlan(view, prepared.layout);
  }
  py::dict d;
#define BUNDLE_FIELD(name) d[#name] = size.name
  BUNDLE_FIELD(num_points);
  BUNDLE_FIELD(num_free_points);
  BUNDLE_FIELD(num_observations);
  BUNDLE_FIELD(num_pairs);
  BUNDLE_FIELD(num_kinds);
  BUNDLE_FIELD(num_tile_blocks);
  BUNDLE_FIELD(num_chunk_pairs);
  BUNDLE_FIELD(num_chunk_parts);
  BUNDLE_FIELD(largest_chunk_blocks);
  BUNDLE_FIELD(block_doubles);
#undef BUNDLE_FIELD
  return d;
}

/// Takes the output of `_core.reduced_pattern`.
bundle::BlockPatternView View(const Array<int>& sizes, const Array<int64_t>& column_begin,
                              const Array<int>& rows) {
  return {static_cast<int>(sizes.size()), sizes.data(), column_begin.data(), rows.data()};
}

double PanelValues(const Array<int>& sizes, const Array<int64_t>& column_begin,
                   const Array<int>& rows, const Array<int>& order) {
  const bundle::BlockPatternView pattern = View(sizes, column_begin, rows);
  const std::vector<int> blocks(order.data(), order.data() + order.size());
  const ReleaseGil release;
  return bundle::CountPanelValues(pattern, blocks);
}

py::dict CountPanelWork(const Array<int>& sizes, const Array<int64_t>& column_begin,
                        const Array<int>& rows, const Array<int>& order, double near_cache,
                        double far_cache, int num_threads) {
  const bundle::BlockPatternView pattern = View(sizes, column_begin, rows);
  const std::vector<int> blocks(order.data(), order.data() + order.size());
  bundle::PanelWork work;
  {
    const ReleaseGil release;
    work = bundle::CountPanelWork(pattern, blocks, {near_cache, far_cache}, num_threads);
  }
  py::dict result;
#define BUNDLE_FIELD(name) result[#name] = work.name
  BUNDLE_FIELD(panels);
  BUNDLE_FIELD(updates);
  BUNDLE_FIELD(stored);
  BUNDLE_FIELD(products);
  BUNDLE_FIELD(reads);
  BUNDLE_FIELD(near_misses);
  BUNDLE_FIELD(far_misses);
  BUNDLE_FIELD(update_flops);
  BUNDLE_FIELD(factor_flops);
  BUNDLE_FIELD(row_blocks);
  BUNDLE_FIELD(busiest_share);
#undef BUNDLE_FIELD
  return result;
}

/// The linear solver that the fused backend's `auto` chooses, in upper case, and true if conjugate
/// gradients would not form S.
std::pair<std::string, bool> AutoChoice(const Array<int>& sizes, const Array<int64_t>& column_begin,
                                        const Array<int>& rows, int num_threads,
                                        int64_t num_observations, int64_t num_pairs) {
  const bundle::BlockPatternView pattern = View(sizes, column_begin, rows);
  const ReleaseGil release;
  const bundle::SolverChoice choice =
      bundle::ChooseByPattern(pattern, num_threads, num_observations, num_pairs);
  return {bundle::UpperName(choice.type, bundle::kLinearSolverTypes), choice.leaves_out_system};
}

bool SumsAreDoubleDoubles(const std::string& linear_solver_type, int num_columns,
                          int64_t num_blocks, int64_t num_entries) {
  for (const auto& [name, type] : bundle::kLinearSolverTypes) {
    if (name != linear_solver_type) continue;
    return bundle::ChooseSumOrder(type, num_columns, num_blocks, num_entries,
                                  /*has_maps=*/false,
                                  /*is_implicit=*/false) == bundle::SumOrder::kSections;
  }
  return false;
}

}  // namespace

void BindInspection(py::module_& m) {
  m.attr("MAX_TRACK_LENGTH") = bundle::kMaxTrackLength;
  m.def("sums_are_double_doubles", &SumsAreDoubleDoubles, py::arg("linear_solver_type"),
        py::arg("num_columns"), py::arg("num_blocks"), py::arg("num_entries"));
  m.def("available_memory", [] { return bundle::AvailableMemoryBytes(); });
  m.def("parameter_blocks", &ParameterBlocks, py::arg("problem"), py::arg("options"));
  m.def("panel_values", &PanelValues, py::arg("sizes"), py::arg("column_begin"), py::arg("rows"),
        py::arg("order"));
  m.def("panel_work", &CountPanelWork, py::arg("sizes"), py::arg("column_begin"), py::arg("rows"),
        py::arg("order"), py::arg("near_cache"), py::arg("far_cache"), py::arg("num_threads"));
  m.def("auto_choice", &AutoChoice, py::arg("sizes"), py::arg("column_begin"), py::arg("rows"),
        py::arg("num_threads"), py::arg("num_observations"), py::arg("num_pairs"));
  m.def("elimination_plan", &EliminationPlan, py::arg("problem"), py::arg("options"));
}
