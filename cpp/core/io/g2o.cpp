#include "core/io/g2o.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <string_view>
#include <utility>

#include "core/io/line_cursor.h"
#include "core/io/number_writer.h"

namespace bundle {
namespace {

/// Differences between the plane and space.
struct G2oKind {
  int dimension;
  std::string_view vertex, edge;
  int ambient, tangent;
  /// Index of the file's k-th number in a stored pose, and in a tangent vector.
  int pose_place[7], tangent_place[6];
  bool is_toro = false;
};

constexpr G2oKind kG2oKinds[] = {
    {2, "VERTEX_SE2", "EDGE_SE2", 3, 3, {0, 1, 2}, {0, 1, 2}},
    {3, "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", 7, 6, {4, 5, 6, 0, 1, 2, 3}, {3, 4, 5, 0, 1, 2}},
    {2, "VERTEX2", "EDGE2", 3, 3, {0, 1, 2}, {0, 1, 2}, true},
    {3, "VERTEX3", "EDGE3", 7, 6, {4, 5, 6, 0, 1, 2, 3}, {3, 4, 5, 0, 1, 2}, true},
};

/// Sensor data without information on poses.
constexpr std::string_view kSensorPackets[] = {"ROBOTLASER1", "RAWLASER1", "FLASER", "VERTEX_TAG",
                                               "VERTEX_ELLIPSE"};

/// Rows and columns of TORO's six numbers of information in 2D.
constexpr int kToroPlane[6][2] = {{0, 0}, {0, 1}, {1, 1}, {2, 2}, {0, 2}, {1, 2}};

constexpr const char* kPoseNames2[] = {"x", "y", "the angle"};
constexpr const char* kPoseNames3[] = {"x", "y", "z", "qx", "qy", "qz", "qw"};
constexpr const char* kToroNames3[] = {"x", "y", "z", "roll", "pitch", "yaw"};

/// R_z(yaw) R_y(pitch) R_x(roll), as qx qy qz qw.
void QuaternionOfAngles(double roll, double pitch, double yaw, double* q) {
  const double cr = std::cos(roll / 2), sr = std::sin(roll / 2);
  const double cp = std::cos(pitch / 2), sp = std::sin(pitch / 2);
  const double cy = std::cos(yaw / 2), sy = std::sin(yaw / 2);
  q[0] = sr * cp * cy - cr * sp * sy;
  q[1] = cr * sp * cy + sr * cp * sy;
  q[2] = cr * cp * sy - sr * sp * cy;
  q[3] = cr * cp * cy + sr * sp * sy;
}

/// Positions by id.
class IdTable {
 public:
  explicit IdTable(const std::vector<int64_t>& ids) : ids_(ids), order_(ids.size()) {
    std::iota(order_.begin(), order_.end(), 0);
    const auto less = [&](int32_t a, int32_t b) { return ids[a] < ids[b]; };
    // Stable sort, so that the later of two vertices with one id is the duplicate.
    if (!std::is_sorted(ids.begin(), ids.end())) {
      std::stable_sort(order_.begin(), order_.end(), less);
    }
  }

  /// -1 if there is no such id.
  int32_t Find(int64_t id) const {
    const auto below = [&](int32_t position, int64_t value) { return ids_[position] < value; };
    // Most ids increase by 1 from each vertex to the next.
    const auto guess =
        static_cast<uint64_t>(id) - static_cast<uint64_t>(ids_.empty() ? 0 : First());
    if (guess < order_.size() && ids_[order_[guess]] == id) return order_[guess];
    const auto found = std::lower_bound(order_.begin(), order_.end(), id, below);
    return found != order_.end() && ids_[*found] == id ? *found : -1;
  }

  /// Positions of a vertex whose id is repeated, and of the first vertex with this id; {-1, -1} if
  /// all ids are unique.
  std::pair<int32_t, int32_t> FindTwins() const {
    for (size_t k = 1; k < order_.size(); ++k) {
      if (ids_[order_[k]] == ids_[order_[k - 1]]) return {order_[k], order_[k - 1]};
    }
    return {-1, -1};
  }

 private:
  int64_t First() const { return ids_[order_.front()]; }

  const std::vector<int64_t>& ids_;
  std::vector<int32_t> order_;
};

class G2oReader {
 public:
  G2oReader(InputFile& file, const std::function<void()>& on_block) : cursor_(file, on_block) {}

  G2oGraph Read() {
    while (cursor_.NextRecord()) ReadRecord(cursor_.Token());
    if (kind_ == nullptr) {
      cursor_.FailAt(std::max<int64_t>(cursor_.line(), 1),
                     "vertices and edges of a pose graph (VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, "
                     "EDGE_SE3:QUAT, or TORO's VERTEX2, EDGE2, VERTEX3, EDGE3)",
                     "the end of the file");
    }
    Resolve();
    return std::move(graph_);
  }

 private:
  void ReadRecord(std::string_view tag) {
    if (tag == "VERTEX" || tag == "EDGE") tag = tag == "EDGE" ? "EDGE2" : "VERTEX2";
    for (const G2oKind& kind : kG2oKinds) {
      if (tag != kind.vertex && tag != kind.edge) continue;
      if (kind_ != nullptr && kind_ != &kind) {
        cursor_.FailWith("poses and edges of one kind (" + std::string(kind_->vertex) + ", " +
                             std::string(kind_->edge) + ")",
                         Quoted(tag));
      }
      kind_ = &kind;
      return tag == kind.vertex ? ReadVertex() : ReadEdge();
    }
    if (tag == "FIX") return ReadFix();
    if (tag.substr(0, 7) == "PARAMS_") return;
    if (tag == "EQUIV") return ReadEquivalence();
    if (std::find(std::begin(kSensorPackets), std::end(kSensorPackets), tag) !=
        std::end(kSensorPackets)) {
      ++graph_.num_sensor_packets;
      return;
    }
    cursor_.FailWith(
        "VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT, FIX or TORO's VERTEX2, EDGE2, "
        "VERTEX3, EDGE3",
        Quoted(tag));
  }

  void ReadVertex() {
    const int64_t id = ReadId("vertex");
    if (static_cast<int64_t>(graph_.ids.size()) == std::numeric_limits<int32_t>::max()) {
      cursor_.FailWith("at most 2147483647 vertices", "one more");
    }
    graph_.ids.push_back(id);
    vertex_lines_.push_back(cursor_.line());
    ReadPose(&graph_.poses, [&] { return "vertex " + std::to_string(id); });
    ExpectEnd(1 + NumPoseNumbers());
  }

  void ReadEdge() {
    const int64_t from = ReadId("first vertex"), to = ReadId("second vertex");
    if (from == to) {
      cursor_.FailWith("an edge between two vertices",
                       "an edge of vertex " + std::to_string(from) + " with itself");
    }
    edge_ids_.push_back(from);
    edge_ids_.push_back(to);
    graph_.edge_lines.push_back(cursor_.line());
    const auto name = [&] { return "edge " + std::to_string(from) + " " + std::to_string(to); };
    ReadPose(&graph_.measurements, name);
    const int n = kind_->tangent;
    const size_t begin = graph_.information.size();
    graph_.information.resize(begin + n * n);
    double* const matrix = graph_.information.data() + begin;
    if (kind_->is_toro && cursor_.AtEndOfLine()) {
      for (int r = 0; r < n; ++r) matrix[r * n + r] = 1;
      ++graph_.num_plain_edges;
      return;
    }
    for (int r = 0, k = 0; r < n; ++r) {
      for (int c = r; c < n; ++c, ++k) {
        double value = 0;
        if (!cursor_.Read(&value, [](double v) { return std::isfinite(v); })) {
          cursor_.Fail("the information of " + name() + " in row " + std::to_string(r + 1) +
                       ", column " + std::to_string(c + 1) + " (a finite number)");
        }
        const bool is_permuted = kind_->is_toro && n == 3;
        const int a = is_permuted ? kToroPlane[k][0] : kind_->tangent_place[r];
        const int b = is_permuted ? kToroPlane[k][1] : kind_->tangent_place[c];
        matrix[a * n + b] = matrix[b * n + a] = value;
      }
    }
    ExpectEnd(2 + NumPoseNumbers() + n * (n + 1) / 2);
  }

  void ReadEquivalence() {
    ReadId("first vertex");
    ReadId("second vertex");
    ExpectEnd(2);
    ++graph_.num_equivalences;
  }

  void ReadFix() {
    do {
      fixed_ids_.push_back({ReadId("vertex"), cursor_.line()});
    } while (!cursor_.AtEndOfLine());
  }

  /// Numbers of a pose in the file.
  int NumPoseNumbers() const { return kind_->is_toro ? kind_->tangent : kind_->ambient; }

  template <typename Name>
  void ReadPose(std::vector<double>* poses, const Name& name) {
    double pose[7], angles[3];
    const bool has_angles = kind_->is_toro && kind_->dimension == 3;
    for (int k = 0; k < NumPoseNumbers(); ++k) {
      double& value = has_angles && k >= 3 ? angles[k - 3] : pose[kind_->pose_place[k]];
      if (cursor_.Read(&value, [](double v) { return std::isfinite(v); })) continue;
      const auto* const names = has_angles              ? kToroNames3
                                : kind_->dimension == 2 ? kPoseNames2
                                                        : kPoseNames3;
      cursor_.Fail(std::string(names[k]) + " of " + name() + " (a finite number)");
    }
    if (has_angles) QuaternionOfAngles(angles[0], angles[1], angles[2], pose);
    if (kind_->dimension == 3 && pose[0] == 0 && pose[1] == 0 && pose[2] == 0 && pose[3] == 0) {
      cursor_.FailWith("a rotation qx qy qz qw of " + name(), "a quaternion of norm 0");
    }
    poses->insert(poses->end(), pose, pose + kind_->ambient);
  }

  int64_t ReadId(const char* what) {
    int64_t id = 0;
    if (!cursor_.Read(&id, [](int64_t value) { return value >= 0; })) {
      cursor_.Fail(std::string("the id of the ") + what + " (a whole number from 0)");
    }
    return id;
  }

  void ExpectEnd(int numbers) {
    if (cursor_.AtEndOfLine()) return;
    cursor_.Fail("the end of the line after " + std::to_string(numbers) + " numbers");
  }

  void Resolve() {
    graph_.dimension = kind_->dimension;
    graph_.is_toro = kind_->is_toro;
    graph_.has_vertices = !graph_.ids.empty();
    if (!graph_.has_vertices) TakeIdsOfEdges();
    const IdTable table(graph_.ids);
    const auto [second, first] = table.FindTwins();
    if (second >= 0) {
      cursor_.FailAt(vertex_lines_[second], "a new vertex",
                     "vertex " + std::to_string(graph_.ids[second]) + " of line " +
                         std::to_string(vertex_lines_[first]) + " again");
    }
    const auto position = [&](int64_t id, int64_t line) {
      const int32_t found = table.Find(id);
      if (found < 0) {
        cursor_.FailAt(
            line, "a vertex of the file",
            "vertex " + std::to_string(id) + ", which has no line " + std::string(kind_->vertex));
      }
      return found;
    };
    graph_.edges.reserve(edge_ids_.size());
    for (size_t k = 0; k < edge_ids_.size(); ++k) {
      graph_.edges.push_back(position(edge_ids_[k], graph_.edge_lines[k / 2]));
    }
    graph_.fixed.assign(graph_.ids.size(), 0);
    for (const auto& [id, line] : fixed_ids_) graph_.fixed[position(id, line)] = 1;
  }

  void TakeIdsOfEdges() {
    graph_.ids = edge_ids_;
    std::sort(graph_.ids.begin(), graph_.ids.end());
    graph_.ids.erase(std::unique(graph_.ids.begin(), graph_.ids.end()), graph_.ids.end());
    const int n = kind_->ambient;
    graph_.poses.assign(graph_.ids.size() * n, 0.0);
    for (size_t i = 0; kind_->dimension == 3 && i < graph_.ids.size(); ++i) {
      graph_.poses[i * n + 3] = 1;
    }
  }

  LineCursor cursor_;
  const G2oKind* kind_ = nullptr;
  G2oGraph graph_;
  std::vector<int64_t> vertex_lines_;
  std::vector<int64_t> edge_ids_;
  std::vector<std::pair<int64_t, int64_t>> fixed_ids_;  ///< id and line
};

void WritePose(const G2oKind& kind, const double* pose, char end, NumberWriter* writer) {
  for (int k = 0; k < kind.ambient; ++k) {
    writer->Write(pose[kind.pose_place[k]], k + 1 < kind.ambient ? ' ' : end);
  }
}

void WriteInformation(const G2oKind& kind, const double* matrix, NumberWriter* writer) {
  const int n = kind.tangent;
  for (int r = 0; r < n; ++r) {
    for (int c = r; c < n; ++c) {
      const int a = kind.tangent_place[r], b = kind.tangent_place[c];
      writer->Write(matrix[std::min(a, b) * n + std::max(a, b)], r + 1 < n ? ' ' : '\n');
    }
  }
}

}  // namespace

G2oGraph ReadG2o(const std::filesystem::path& path, const std::function<void()>& on_block) {
  const std::unique_ptr<InputFile> file = InputFile::Open(path);
  return G2oReader(*file, on_block).Read();
}

void WriteG2o(const G2oView& graph, const std::filesystem::path& path, Compression compression,
              const std::function<void()>& on_block) {
  const G2oKind& kind = kG2oKinds[graph.dimension - 2];
  OutputFile file(path, compression);
  NumberWriter writer({&file}, on_block);
  for (int64_t i = 0; i < graph.num_poses; ++i) {
    writer.WriteWord(kind.vertex, ' ');
    writer.Write(graph.ids[i], ' ');
    WritePose(kind, graph.poses + i * kind.ambient, '\n', &writer);
  }
  for (int64_t i = 0; i < graph.num_poses; ++i) {
    if (graph.fixed[i] == 0) continue;
    writer.WriteWord("FIX", ' ');
    writer.Write(graph.ids[i], '\n');
  }
  const int64_t square = int64_t{kind.tangent} * kind.tangent;
  for (int64_t e = 0; e < graph.num_edges; ++e) {
    writer.WriteWord(kind.edge, ' ');
    writer.Write(graph.ids[graph.edges[2 * e]], ' ');
    writer.Write(graph.ids[graph.edges[2 * e + 1]], ' ');
    WritePose(kind, graph.measurements + e * kind.ambient, ' ', &writer);
    WriteInformation(kind, graph.information + e * square, &writer);
  }
  writer.Flush();
  file.Close();
}

}  // namespace bundle
