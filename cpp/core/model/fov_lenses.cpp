#include "core/model/fov_lenses.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "core/factors/loss.h"
#include "core/geometry/rotation.h"
#include "core/model/free_parameters.h"
#include "core/sums/communicator.h"

namespace bundle {
namespace {

constexpr int kOmega = 4;  // fx, fy, cx, cy, omega
/// Omega from which to continue inside the range of the discontinuity, and limits of this range.
constexpr double kWithin = 5e-3;
constexpr double kOutside = 0.1, kFarOutside = 1;

int64_t PlaceOfOmega(const ProblemView& problem, int lens) {
  return int64_t{lens} * problem.camera_params_stride + kOmega;
}

}  // namespace

std::vector<int> FindFreeFovLenses(const AdjustmentProblem& problem, const SolveOptions& options) {
  std::vector<int> lenses;
  for (int c = 0; c < problem.num_cameras; ++c) {
    if (problem.camera_model_names[c] == "FOV") lenses.push_back(c);
  }
  if (lenses.empty()) return lenses;
  const FreeParameters free = SelectFreeParameters(problem, options);
  const auto is_other = [&](int c) {
    const int64_t at = PlaceOfOmega(problem, c);
    const bool has_bounds = problem.restrictions.camera_lower != nullptr &&
                            (std::isfinite(problem.restrictions.camera_lower[at]) ||
                             std::isfinite(problem.restrictions.camera_upper[at]));
    const bool is_multiple = problem.restrictions.camera_tie != nullptr &&
                             problem.restrictions.camera_tie[at] >= 0 &&
                             problem.restrictions.camera_tie_scale[at] != 1;
    return (free.camera[c] >> kOmega & 1u) == 0 || has_bounds || is_multiple;
  };
  lenses.erase(std::remove_if(lenses.begin(), lenses.end(), is_other), lenses.end());
  return lenses;
}

double OmegaOf(const ProblemView& problem, int lens) {
  return problem.camera_params[PlaceOfOmega(problem, lens)];
}

void SetOmega(const ProblemView& problem, int lens, double omega, std::vector<double>* params) {
  (*params)[PlaceOfOmega(problem, lens)] = omega;
}

double OmegaBesidePinhole(const AdjustmentProblem& problem, int lens, const SolveOptions& options) {
  const double* const params = problem.ParamsOf(lens);
  double slope = 0, curvature = 0;
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const int image = problem.observation_image[i];
    if (problem.image_camera[image] != lens) continue;
    const double* const pose = problem.cam_from_world + 7 * int64_t{image};
    double rotation[9], point[3];
    QuaternionToRotation(pose, rotation);
    MatrixVector3(rotation, problem.points + 3 * int64_t{problem.observation_point[i]}, point);
    for (int j = 0; j < 3; ++j) point[j] += pose[4 + j];
    if (!(point[2] > 0)) continue;
    const double ray[2] = {point[0] / point[2], point[1] / point[2]};
    const double by_z = (ray[0] * ray[0] + ray[1] * ray[1]) / 3 - 1.0 / 12;
    const double sigma = problem.observation_sigma == nullptr ? 1 : problem.observation_sigma[i];
    double squared = 0, product = 0, change = 0, rho[3];
    for (int j = 0; j < 2; ++j) {
      const double pixel = params[j] * ray[j];
      const double r = (pixel + params[2 + j] - problem.observation_xy[2 * i + j]) / sigma;
      const double dr = by_z * pixel / sigma;
      squared += r * r, product += r * dr, change += dr * dr;
    }
    ValueOfLoss(options.loss, options.loss_scale, squared, rho);
    slope += rho[1] * product;
    curvature += rho[1] * change;
  }
  slope = SumOverRanks(problem.division.communicator, slope);
  curvature = SumOverRanks(problem.division.communicator, curvature);
  if (slope == 0 || !(curvature > 0)) return 0;
  if (slope < 0) return kWithin;
  return std::clamp(std::sqrt(slope / curvature), kOutside, kFarOutside);
}

}  // namespace bundle
