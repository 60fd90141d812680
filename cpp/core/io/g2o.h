#pragma once

/// Reader and writer of pose graphs in g2o's text format; reader of TORO's format.
///
///   VERTEX_SE2 id x y angle
///   EDGE_SE2 i j x y angle  I11 I12 I13 I22 I23 I33
///   VERTEX_SE3:QUAT id x y z qx qy qz qw
///   EDGE_SE3:QUAT i j x y z qx qy qz qw  I11 I12 ... I16 I22 ... I66
///   FIX id ...
///
/// A pose is world_from_body; an edge measures X_i^-1 X_j. Files have the upper triangle of each
/// information matrix, by x y angle in 2D and by x y z qx qy qz in 3D. We store poses as
/// COLMAP does (qx qy qz qw tx ty tz) and information in the order of the tangent coordinates of
/// geometry/retraction.h (rotation, then translation): a permutation, exact in floating point. All
/// numbers stay as they are in the file, including lengths of quaternions and full turns of angles.
///
/// TORO's files (Grisetti, Stachniss, Grzonka, Burgard: TORO, 2007) differ little and are read,
/// too:
///
///   VERTEX2 id x y angle
///   EDGE2 i j x y angle  I11 I12 I22 I33 I13 I23
///   VERTEX3 id x y z roll pitch yaw
///   EDGE3 i j x y z roll pitch yaw  I11 I12 ... I16 I22 ... I66
///
/// R = R_z(yaw) R_y(pitch) R_x(roll); the information in 3D is by x y z roll pitch yaw, which
/// for small errors equal x y z and the rotation vector. An edge without information has the
/// identity as its information. VERTEX and EDGE, as TORO writes them in 2D, are VERTEX2 and
/// EDGE2. EQUIV i j names an edge that TORO may collapse later; here, the edge is used as measured.
/// Files are written with g2o's records.
///
/// Lines of parameters (PARAMS_...), comments (#) and packets of sensors (ROBOTLASER1 and other
/// data that g2o attaches to vertices) are skipped and counted. The format is that of g2o's types
/// slam2d and slam3d (https://github.com/RainerKuemmerle/g2o/wiki/File-Format).

#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "core/io/output_file.h"

namespace bundle {

struct G2oGraph {
  int dimension = 0;                 ///< 2 or 3
  bool has_vertices = false;         ///< false: `poses` are zero, ids those of the edges, ascending
  std::vector<int64_t> ids;          ///< num_poses, in the order of the file
  std::vector<double> poses;         ///< num_poses x 3 (x y angle) or 7 (qx qy qz qw tx ty tz)
  std::vector<uint8_t> fixed;        ///< num_poses, 1 for poses with a FIX record
  std::vector<int32_t> edges;        ///< num_edges x 2: positions of poses
  std::vector<double> measurements;  ///< num_edges x 3 or 7
  std::vector<double> information;   ///< num_edges x d x d with d = 3 or 6, symmetric
  std::vector<int64_t> edge_lines;   ///< num_edges: line of each edge in the file
  bool is_toro = false;
  int64_t num_plain_edges = 0;     ///< number of edges without information
  int64_t num_equivalences = 0;    ///< number of EQUIV records
  int64_t num_sensor_packets = 0;  ///< number of ROBOTLASER1 and similar records
};

/// Reads a g2o file, plain or compressed by gzip or bzip2, as a stream. `on_block` is called
/// between blocks of about a megabyte and may throw.
///
/// Throws InputError `NAME:LINE: expected ..., found ...` and std::system_error.
G2oGraph ReadG2o(const std::filesystem::path& path, const std::function<void()>& on_block);

/// Contents of a g2o file, in the caller's arrays, as in G2oGraph.
struct G2oView {
  int dimension = 0;
  int64_t num_poses = 0;
  int64_t num_edges = 0;
  const int64_t* ids = nullptr;
  const double* poses = nullptr;
  const uint8_t* fixed = nullptr;
  const int32_t* edges = nullptr;
  const double* measurements = nullptr;
  const double* information = nullptr;  ///< only the upper triangles are used
};

/// Writes a g2o file. Numbers are the shortest that read back as the same double. `on_block` as
/// above. Throws std::system_error.
void WriteG2o(const G2oView& graph, const std::filesystem::path& path, Compression compression,
              const std::function<void()>& on_block);

}  // namespace bundle
