#pragma once

/// Parts of the camera parameters, by which the passes over the points sum.
///
/// The parameters that an image depends on are divided into parts: its *own* (its pose, and the
/// parameters of its camera if no other image uses them), its *camera's* and its *sensor's*. Images
/// of a frame share one such part, the pose of the frame. A part has the columns that any of its
/// images refines. Assembler assigns these columns to unknowns.

#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/model/parameter_layout.h"
#include "core/schur/kernels/kernels.h"

namespace bundle {

struct CameraPart {
  PartKind kind = kOwnPart;
  int image = 0;  ///< the first image that depends on it
  int num_columns = 0;
  int num_quads = 0;
  /// Column of an image (ParameterLayout) per column of the part; of a sensor: of its pose.
  const int8_t* columns = nullptr;
};

/// The parts of a problem, and the Jacobian records of its images.
class ImageParts {
 public:
  /// Images of unknown camera models are in the first group; no observation is in them.
  ImageParts(const AdjustmentProblem& problem, const ParameterLayout& layout);
  ImageParts(const ImageParts&) = delete;
  ImageParts& operator=(const ImageParts&) = delete;

  const std::vector<ModelGroup>& groups() const { return groups_; }
  const std::vector<uint8_t>& image_group() const { return image_group_; }
  /// Per image: 1 if it has a part.
  const std::vector<uint8_t>& image_refined() const { return image_refined_; }

  int num_parts() const { return static_cast<int>(parts_.size()); }
  int num_own_parts() const { return num_own_parts_; }
  /// Own parts come in the order of their blocks of the layout, then cameras, then sensors.
  const CameraPart& part(int part) const { return parts_[part]; }
  /// The part of an image, -1: none.
  int part_of(int image, int kind) const { return of_image_[kMaxParts * image + kind]; }
  /// Number of kinds up to the last kind in use.
  int num_kinds() const { return num_kinds_; }

  /// Columns and quads per part, as EliminationInput needs them.
  const std::vector<uint8_t>& part_rows() const { return part_rows_; }
  const std::vector<uint8_t>& part_quads() const { return part_quads_; }

  int record_columns() const { return record_columns_; }  ///< columns of the widest record
  int part_columns() const { return part_columns_; }  ///< those of the widest part, in whole quads
  /// EliminationInput::own_quads and camera_quads.
  int own_quads() const { return own_quads_; }
  int camera_quads() const { return camera_quads_; }
  /// Average doubles of a block of two parts.
  int block_size() const { return block_size_; }

 private:
  void GroupImages(const AdjustmentProblem& problem, const ParameterLayout& layout);
  void NumberParts(const AdjustmentProblem& problem, const ParameterLayout& layout);
  void Measure();

  std::vector<ModelGroup> groups_;
  std::vector<uint8_t> image_group_, image_refined_;
  std::vector<CameraPart> parts_;
  std::vector<int32_t> of_image_;
  std::vector<uint8_t> part_rows_, part_quads_;
  int num_own_parts_ = 0, num_kinds_ = 1;
  int record_columns_ = 4, part_columns_ = 4, own_quads_ = 0, camera_quads_ = 0, block_size_ = 1;
};

}  // namespace bundle
