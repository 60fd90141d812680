#pragma once

/// Parts of a BAL file as text; digits: number_writer.h. bal.h defines the numbers.

#include <algorithm>
#include <cstdint>

#include "core/io/bal.h"
#include "core/io/number_writer.h"

namespace bundle {

inline void WriteObservation(const BalView& problem, int32_t image, int32_t point, const double* xy,
                             NumberWriter* writer) {
  const double* params = problem.camera_params + 5 * int64_t{image};
  writer->Write(image, ' ');
  writer->Write(point, ' ');
  writer->Write(xy[0] - params[1], ' ');
  writer->Write(-(xy[1] - params[2]), '\n');
}

inline void WriteCameras(const BalView& problem, NumberWriter* writer) {
  for (int64_t i = 0; i < problem.num_images; ++i) {
    double pose[6];
    BalFromCamFromWorld(problem.cam_from_world + 7 * i, pose);
    if (problem.rotations != nullptr && problem.keeps_rotation[i] != 0) {
      std::copy_n(problem.rotations + 3 * i, 3, pose);
    }
    for (const double value : pose) writer->Write(value, '\n');
    const double* params = problem.camera_params + 5 * i;
    for (const int k : {0, 3, 4}) writer->Write(params[k], '\n');
  }
}

inline void WritePoints(const BalView& problem, NumberWriter* writer) {
  for (int64_t i = 0; i < 3 * int64_t{problem.num_points}; ++i)
    writer->Write(problem.points[i], '\n');
}

inline void WriteObservations(const BalView& problem, NumberWriter* writer) {
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    WriteObservation(problem, problem.observation_image[i], problem.observation_point[i],
                     problem.observation_xy + 2 * i, writer);
  }
}

}  // namespace bundle
