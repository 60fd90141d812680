#include "core/solver/newton_decrement.h"

#include <utility>

#include "core/error.h"
#include "core/prepare/prepare.h"
#include "core/solver/fused_solver.h"
#include "core/solver/fused_support.h"

namespace bundle {

NewtonDecrement MeasureNewtonDecrement(const AdjustmentProblem& problem,
                                       const SolveOptions& options) {
  SolveOptions own;
  own.loss = options.loss;
  own.loss_scale = options.loss_scale;
  VisitRefine([&](const char* /*name*/, auto member) { own.*member = options.*member; });
  own.refine_sensor_from_rig = options.refine_sensor_from_rig;
  own.refine_readout = options.refine_readout;
  own.twists = options.twists;
  own.fixed_camera_ids = options.fixed_camera_ids;
  own.fixed_image_ids = options.fixed_image_ids;
  own.fixed_point_ids = options.fixed_point_ids;
  own.fixed_sensors = options.fixed_sensors;
  own.gauge = options.gauge;
  own.cheirality = options.cheirality;
  own.num_threads = options.num_threads;
  own.deterministic = options.deterministic;
  try {
    PreparedSolve prepared = PrepareSolve(problem, own);
    if (FindUnsupported(own, prepared)) return {};
    return FusedSolver(problem, own, std::move(prepared), /*is_reused=*/false).Decrement();
  } catch (const InputError&) {  // too little memory
  } catch (const Interrupted&) {
  }
  return {};
}

}  // namespace bundle
