#pragma once

/// The passes over a chunk of points, compiled once for each instruction set.

#include <cstdint>

#include "core/interface/options.h"
// Unused, but it must stay: without it, GCC 12 fuses other multiply-adds of Products, which changes
// the bits of results.
#include "core/model/camera_states.h"
#include "core/schur/column_map.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/held_residuals.h"

namespace bundle {

/// Images with equal Jacobian records: of one camera model and with the same kinds of parts.
struct ModelGroup {
  /// Columns of a part in a row of the record: they begin at a whole quad.
  struct Part {
    int num_columns = 0;  ///< 0: no image of the group has this part
    int num_quads = 0;    ///< num_columns, rounded up
    int first_quad = 0;
  };
  static constexpr int kFirstOfSensor = kImageColumns;
  static constexpr int8_t kNoColumn = -1;

  int model = 0;       ///< index into CameraModels
  bool rolls = false;  ///< images of rolling shutters
  int num_params = 0;  ///< parameters of the model
  Part parts[kMaxParts];
  int num_quads = 0;  ///< quads in a row of the record
  /// Per column of a row: the column in ParameterLayout, which for twists begins at kFirstTwist;
  /// that of the sensor's pose from kFirstOfSensor on; kNoColumn: padding.
  int8_t columns[4 * 8] = {};
};

/// Input of the passes; no pass changes it.
struct EliminationInput {
  const EliminationPlan* plan = nullptr;
  const ModelGroup* groups = nullptr;
  int num_groups = 0;
  const uint8_t* image_group = nullptr;  ///< group per image
  const uint8_t* image_refined = nullptr;
  const uint8_t* part_rows = nullptr;   ///< per part: its columns
  const uint8_t* part_quads = nullptr;  ///< per part: its columns in quads, rounded up
  /// Quads of the own parts, and of the cameras' parts, if they are equal for all images and there
  /// are no other parts; or else 0. Without cameras' parts, the second is 0.
  int own_quads = 0, camera_quads = 0;
  int record_columns = 0;  ///< columns of the widest Jacobian record's rows
  int part_columns = 0;    ///< columns of the widest part, in whole quads
  Cheirality cheirality = Cheirality::kAuto;
  LossType loss = LossType::kTrivial;
  double loss_scale = 1;
  const double* inverse_sigma = nullptr;  ///< per observation of the plan; nullptr: 1 each
  int64_t longest_track = 0;
  /// Per point of the plan: its place in `prior_sums`, or -1. nullptr: no factor depends on a
  /// point.
  const int32_t* point_prior = nullptr;
  /// Per place: contributions of factors to the point's block at the last linearisation. 12
  /// numbers: rows of J^T J, each followed by its entry of J^T r.
  const double* prior_sums = nullptr;
  /// Where eliminate keeps the records of all observations (multiply_schur.h); nullptr: nowhere.
  double* kept_records = nullptr;

  const double* PriorOf(int point) const {
    const int place = point_prior == nullptr ? -1 : point_prior[point];
    return place < 0 ? nullptr : prior_sums + 12 * static_cast<int64_t>(place);
  }
};

/// One state in the form that the passes read: a record per image (rotation 9, translation 3, left
/// Jacobian 9, parameters from 24 on), and the points in the order of the plan.
struct StateRecords {
  static constexpr int kTranslation = 9, kLeftJacobian = 12, kParams = 24;
  /// Offset in a record of the derivative of the translation w.r.t. the translation of the chart (9
  /// numbers); 0: it is the identity. For an image of a rig, this derivative and the left Jacobian
  /// refer to the chart of its frame.
  int translation_jacobian = 0;
  /// Offset in a record of K (factors/rig_pose.h), 6 x 6: a step of the sensor times K is a step of
  /// the frame.
  int sensor_map = 0;
  /// Offset in a record of the twist and the row scale (8 numbers); 0: all shutters are global.
  int shutter = 0;
  bool at_observed_row = false;
  /// Per observation of the plan, only with rolling shutters: the row time where the iteration of
  /// the candidate ended that became this state; NaN: unknown. Rows of a candidate are found anew.
  const double* row_times = nullptr;
  double* found_row_times = nullptr;  ///< row times of a candidate, written by its pass
  const double* images = nullptr;
  int stride = 0;  ///< stride of `images`; a multiple of 4
  const double* points = nullptr;
  const StateRecords* before = nullptr;  ///< for a candidate: the state that the step starts from
  /// Observations with a held residual at this state, ascending; of a candidate, those of the state
  /// before.
  const HeldResidual* held = nullptr;
  int64_t num_held = 0;
  HeldSink sink;  ///< for observations with a held residual at a candidate, or at the start
};

/// Contribution of a chunk to the normal equations, by the chunk's parts and blocks.
struct ChunkSum {
  /// Block b of the chunk begins at block_begin[b]. It has the rows of its first part, each as wide
  /// as the quads of its second part.
  double* blocks = nullptr;
  const int64_t* block_begin = nullptr;
  static constexpr int kVectors = 3;
  /// Per part kVectors x EliminationInput::part_columns: J_c^T r, reduced right-hand side, ||J
  /// e_j||^2, each as wide as the part's quads.
  double* vectors = nullptr;
  /// J_c^T J_c of each part, laid out as the diagonal blocks; nullptr: not needed.
  double* camera_diagonal = nullptr;
  /// 1: sums are on a grid, and the last bits of their terms must be set where products are rounded
  /// before they are added (assembly/sum_grid.h). Else 0.
  int64_t last_bit = 0;
  double* BlockOf(size_t b) const { return blocks + block_begin[b]; }
  double* VectorsOf(const EliminationInput& input, size_t i) const {
    return vectors + int64_t{kVectors} * input.part_columns * static_cast<int64_t>(i);
  }
  double* SquaresOf(size_t i) const {
    return camera_diagonal == nullptr ? nullptr : camera_diagonal + block_begin[i];
  }

  double cost = 0;
  double gradient_squared = 0;  ///< squared norm over the points
  double gradient_max = 0;      ///< maximum norm over the points
  double decrement = 0;         ///< sum of g^T V'^-1 g over the points
};

/// A step of the camera parameters in the form that the passes read. A record per image: J_l dw
/// (3), dt (3) of cam_from_world, 2 unused, dparams from 8 on, and from `twist` on dtwist (6).
struct StepRecords {
  static constexpr int kTranslation = 3, kParams = 8;
  int twist = 0;  ///< 0: all shutters are global
  const double* images = nullptr;
  int stride = 0;
};

struct CandidateSum {
  double model_cost_change = 0;
  double cost = 0;
  double step_squared = 0;   ///< squared norm over the points
  double state_squared = 0;  ///< squared norm over the candidate's points
};

/// Products of the two directions, over the points and over all residuals.
struct ProductSum {
  double d_pp = 0, d_pq = 0, d_qq = 0, j_pp = 0, j_pq = 0, j_qq = 0;
};

/// The seven similarities of the world, and padding (model/gauge.h).
inline constexpr int kMoves = 8;

/// Derivatives of images and points with respect to the similarities about a centre: N of
/// covariance/gauge_sums.h. Translations are in units of the size of the scene.
struct WorldMoves {
  /// N by the columns of a record, record_columns x kMoves per image; nullptr: not needed.
  const double* images = nullptr;
  /// Per image: 1 if all of it moves along with the world, so that no observation of a free point
  /// changes.
  const uint8_t* moves_along = nullptr;
  double center[3] = {};
  double size = 1;
  /// T: the combinations N T that inner constraints remove from points, 7 x kMoves; nullptr: no
  /// constraints.
  const double* combinations = nullptr;
};

/// Least share of a pivot of a point's V in its diagonal entry, and of an entry in the largest one,
/// for a clearly regular V. It is far above the share of a null direction.
inline constexpr double kClearPivot = 1e-6;

/// Sums over the free points of chunks whose V is clearly regular.
struct PointSurvey {
  double squares = 0;   ///< sum of squared residuals
  double decrease = 0;  ///< sum 1/2 g^T V^-1 g
  int64_t num_observations = 0;
  /// If similarities are needed: squares of the two parts of the rows of J N, by images and by
  /// points; sum N_p^T V^-1 N_p and sum N_p^T N_p, both 7 x kMoves; J_c^T J_p V^-1 N_p of each
  /// image, laid out as WorldMoves::images.
  double parts[kMoves] = {};
  double weighted[7 * kMoves] = {};
  double own[7 * kMoves] = {};
  double* eliminated = nullptr;
  /// Callbacks for the rows of observations of images that do not move along, and for points of the
  /// plan that are not clearly regular or are spread over several chunks.
  void* list = nullptr;
  void (*add_row)(void* list, const double* by_images, const double* by_point) = nullptr;
  void (*add_unclear)(void* list, int point) = nullptr;
};

/// Input of point_leverages.
struct LeverageInput {
  /// Blocks of the camera parameters' covariance as for point_covariances, followed by the
  /// transpose of each block of a pair; nullptr: no leverages.
  const double* blocks = nullptr;
  const int64_t* block_begin = nullptr;
  /// EliminationInput::part_columns numbers per part; nullptr: zeros.
  const double* adjoint = nullptr;
};

struct ObservationLeverage {
  double h[3];         ///< upper triangle
  double residual[2];  ///< over sigma, without the weight of the loss
  double along[2];     ///< J~ a; without a part of the points' own
};

/// Where a block of a chunk is added: row i of the block to column i of a block of S.
struct BlockTarget {
  double* sum;  ///< columns `sum_stride` apart
  int64_t sum_stride;
  double* error;  ///< error terms of the sums (double_double.h), or nullptr
  int64_t error_stride;
};

/// Each pass except `cost` works in `memory`, a buffer of `memory_doubles` doubles.
struct Kernels {
  const char* name;

  int64_t (*memory_doubles)(const EliminationInput& input);
  /// Number of further doubles that the three passes on points below need.
  int64_t (*scatter_doubles)(const EliminationInput& input);

  /// Linearises and eliminates. `squared_scale` (3 per point) is written if `first`, else read.
  void (*eliminate)(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                    double damping, bool first, double* squared_scale, double* memory,
                    ChunkSum* sum);

  /// Back-substitutes the step of the cameras, writes the candidate's points, and evaluates both
  /// the model and the candidate.
  void (*evaluate_newton_step)(const EliminationInput& input, const StateRecords& x,
                               const Chunk& chunk, double damping, const double* squared_scale,
                               const StepRecords& step, const StateRecords& candidate,
                               double* candidate_points, double* memory, CandidateSum* sum);

  /// S times a step of the cameras, without damping (multiply_schur.h): adds to `vectors`,
  /// EliminationInput::part_columns numbers per part of the chunk.
  void (*multiply_schur)(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                         double damping, const double* squared_scale, const StepRecords& step,
                         double* memory, double* vectors);
  /// The same from the records that `eliminate` kept. `step`: EliminationInput::part_columns
  /// numbers per part.
  void (*multiply_kept)(const EliminationInput& input, const Chunk& chunk, const double* step,
                        double* memory, double* vectors);
  /// Number of doubles of EliminationInput::kept_records.
  int64_t (*kept_doubles)(const EliminationInput& input);

  /// Adds a block of a chunk to S (assembly/add_block.h).
  void (*add_block)(const double* from, int from_stride, int num_rows, int num_columns,
                    const BlockTarget& to);

  /// out = M_a^T B M_b, for a block B of a chunk with rows of `width` numbers (map_block.h). `out`:
  /// kMaxMapped numbers.
  void (*map_block)(const PartBlock& a, const PartBlock& b, const double* block, int width,
                    double* out);

  /// Computes both directions of the points (3 numbers per point each) from those of the cameras,
  /// and products. `d_squared`: D^2 of the free points' columns; nullptr: not needed.
  void (*products)(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                   double damping, const double* squared_scale, const StepRecords& p,
                   const StepRecords& q, double* points_p, double* points_q, double* d_squared,
                   double* memory, ProductSum* sum);

  /// The cost of the chunk at a state.
  double (*cost)(const EliminationInput& input, const StateRecords& x, const Chunk& chunk);

  /// d^T J^T r over the chunk at a state, for a step d of the cameras and of the points (3 numbers
  /// each).
  double (*slope)(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                  const StepRecords& step, const double* points_step, double* memory);

  /// Adds to the sums and to the lists (survey_points.h).
  void (*survey_points)(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                        const WorldMoves& moves, double* memory, PointSurvey* survey);

  /// Covariances of a chunk's free points (point_covariances.h), 3 x 3 each, from the blocks of the
  /// camera parameters' covariance. These are laid out as ChunkSum::blocks, diagonal blocks with
  /// both triangles. Leaves out points that are spread over several chunks.
  void (*point_covariances)(const EliminationInput& input, const StateRecords& x,
                            const Chunk& chunk, const WorldMoves& moves, const double* blocks,
                            const int64_t* block_begin, double* memory, double* covariances);

  /// Leverages of the observations of a chunk's free points (point_leverages.h). Leaves out points
  /// that are spread over several chunks. `covariances` of the points as in point_covariances,
  /// without constraints; nullptr: not needed.
  void (*point_leverages)(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                          const LeverageInput& given, double* memory, ObservationLeverage* found,
                          double* covariances);

  /// V^-1 of a chunk's free points (9 numbers), and Y^T X of steps X of the camera parameters,
  /// three rows of `num_quads` quads, at most kMostMoved numbers (point_movements.h). `steps`:
  /// likewise EliminationInput::part_columns rows per part. Leaves out points as above.
  static constexpr int kMostMoved = 28;
  void (*point_movements)(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                          const double* steps, int num_quads, double* memory, double* found);
};

/// Kernels for the best instruction set of this machine.
const Kernels& SelectKernels();

}  // namespace bundle
