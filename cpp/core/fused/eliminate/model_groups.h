#pragma once

#include <cstdint>
#include <vector>

#include "core/fused/eliminate/kernels.h"
#include "core/problem/problem_view.h"
#include "core/solve/parameter_layout.h"

namespace bundle::fused {

/// The images of a problem by camera model, and what each model's Jacobian records hold.
struct ModelGroups {
  std::vector<ModelGroup> groups;
  std::vector<uint8_t> image_group;    ///< of each image
  std::vector<uint8_t> image_columns;  ///< of each image: num_columns of its group
  std::vector<uint8_t> image_quads;    ///< of each image: num_quads of its group
  std::vector<uint8_t> image_refined;  ///< of each image: 1 if it has a free column
  int num_rows = 1;                    ///< the largest group's columns

  /// Columns of a record.
  int num_columns() const { return (num_rows + 3) / 4 * 4; }
  bool mixed() const;
  /// Doubles of the block of two images, on average.
  int block_size() const;
};

/// A group for each camera model in use. Images of models that we do not know are in the first; no
/// observation is in them.
ModelGroups GroupImages(const ProblemView& problem, const ParameterLayout& layout);

}  // namespace bundle::fused
