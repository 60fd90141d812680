#include "core/io/colmap_text_scanner.h"

// COLMAP's text format, one record a line (two for an image):
//
//   cameras.txt   ID MODEL WIDTH HEIGHT PARAMS[]
//   images.txt    ID QW QX QY QZ TX TY TZ CAMERA_ID NAME
//                 (X Y POINT3D_ID)[]   -1 for none; the line is there, blank, without keypoints
//   points3D.txt  ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)[]
//   rigs.txt      ID NUM_SENSORS [REF_SENSOR_TYPE REF_SENSOR_ID
//                 (SENSOR_TYPE SENSOR_ID HAS_POSE [QW QX QY QZ TX TY TZ])[]]
//   frames.txt    ID RIG_ID QW QX QY QZ TX TY TZ NUM_DATA (SENSOR_TYPE SENSOR_ID DATA_ID)[]
//
// Stricter than COLMAP's own reader, which takes half a keypoint or track element at the end of a
// line for the end of the list, wraps colours round at 256 and drops an image whose second line
// is missing.

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <locale>
#include <sstream>
#include <string>
#include <vector>

#include "core/cameras/registry.h"
#include "core/io/colmap_index.h"
#include "core/io/text_cursor.h"

namespace bundle {

namespace {

/// Characters that COLMAP strips from both ends of a line.
bool IsTrimmed(char c) { return c == ' ' || c == '\t' || c == '\r'; }

/// std::from_chars accepts no plus sign, but the streams of COLMAP's reader do.
const char* SkipPlus(const char* begin, const char* end) {
  const bool has_plus = end - begin > 1 && *begin == '+' && begin[1] != '-' && begin[1] != '+';
  return has_plus ? begin + 1 : begin;
}

}  // namespace

ColmapTextCursor::ColmapTextCursor(const ModelFile& file) : file_(file), window_(file) {
  const size_t size = kByteOrderMark.size();
  if (file.size() < size) return;
  if (std::string_view(window_.At(0, size), size) == kByteOrderMark) next_line_ = size;
}

bool ColmapTextCursor::NextRecord() {
  while (NextLine()) {
    if (cursor_ != end_of_line_ && *cursor_ != '#') return true;
  }
  return false;
}

bool ColmapTextCursor::NextLine() {
  if (next_line_ == file_.size()) return false;
  line_at_ = next_line_;
  ++line_;
  std::string_view ahead = window_.From(line_at_);
  size_t size = ahead.find('\n');
  while (size == std::string_view::npos && line_at_ + ahead.size() < file_.size()) {
    const size_t searched = ahead.size();
    if (searched > kLongestLine) Fail("expected a line of at most 1 GB, found a longer one");
    const auto more = std::min<uint64_t>(2 * searched + kReadBlockSize, file_.size() - line_at_);
    ahead = {window_.At(line_at_, static_cast<size_t>(more)), static_cast<size_t>(more)};
    size = ahead.find('\n', searched);
  }
  const bool is_last = size == std::string_view::npos;
  if (is_last) size = ahead.size();
  next_line_ = line_at_ + size + (is_last ? 0 : 1);
  begin_ = cursor_ = ahead.data();
  end_of_line_ = begin_ + size;
  while (cursor_ != end_of_line_ && IsTrimmed(*cursor_)) ++cursor_;
  while (cursor_ != end_of_line_ && IsTrimmed(end_of_line_[-1])) --end_of_line_;
  return true;
}

bool ColmapTextCursor::AtEndOfLine() {
  while (cursor_ != end_of_line_ && IsSpace(*cursor_)) ++cursor_;
  return cursor_ == end_of_line_;
}

std::string_view ColmapTextCursor::Token(const char* what) {
  if (AtEndOfLine()) Fail(std::string("expected ") + what + ", found the end of the line");
  const char* begin = cursor_;
  while (cursor_ != end_of_line_ && !IsSpace(*cursor_)) ++cursor_;
  return {begin, static_cast<size_t>(cursor_ - begin)};
}

template <typename T>
bool ColmapTextCursor::ParseInteger(const char* what, T max, T* value) {
  if (AtEndOfLine()) Token(what);
  const auto [end, error] = std::from_chars(SkipPlus(cursor_, end_of_line_), end_of_line_, *value);
  if (error != std::errc() || *value > max || (end != end_of_line_ && !IsSpace(*end))) return false;
  cursor_ = end;
  return true;
}

uint64_t ColmapTextCursor::Integer(const char* what, uint64_t max) {
  uint64_t value = 0;
  if (!ParseInteger(what, max, &value)) {
    FailHere(std::string(what) + " (a whole number from 0 to " + std::to_string(max) + ")");
  }
  return value;
}

int64_t ColmapTextCursor::SignedInteger(const char* what) {
  int64_t value = 0;
  if (!ParseInteger(what, std::numeric_limits<int64_t>::max(), &value)) {
    FailHere(std::string(what) + " (a whole number below 2^63)");
  }
  return value;
}

uint32_t ColmapTextCursor::Id(const char* what) {
  return static_cast<uint32_t>(Integer(what, kInvalidColmapId - 1));
}

double ColmapTextCursor::Number(const char* what) {
  if (AtEndOfLine()) Token(what);
  double value = 0.0;
  const char* begin = SkipPlus(cursor_, end_of_line_);
  const auto [end, error] = std::from_chars(begin, end_of_line_, value);
  if (error == std::errc::result_out_of_range) {
    // Too large or too close to zero; from_chars does not distinguish. COLMAP accepts numbers close
    // to zero.
    std::istringstream stream(std::string(begin, end));
    stream.imbue(std::locale::classic());
    if (!(stream >> value)) value = std::numeric_limits<double>::infinity();
  } else if (error != std::errc()) {
    FailHere(std::string(what) + " (a finite number)");
  }
  if (!std::isfinite(value) || (end != end_of_line_ && !IsSpace(*end))) {
    FailHere(std::string(what) + " (a finite number)");
  }
  cursor_ = end;
  return value;
}

std::string_view ColmapTextCursor::Rest(const char* what) {
  if (AtEndOfLine()) Token(what);
  const std::string_view rest(cursor_, static_cast<size_t>(end_of_line_ - cursor_));
  cursor_ = end_of_line_;
  return rest;
}

ColmapSpan ColmapTextCursor::Pose(const std::string& subject, double* pose) {
  static constexpr const char* kNames[] = {"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"};
  const uint64_t begin = NextTokenOffset();
  for (int i = 0; i < 7; ++i) pose[i] = Number(kNames[i]);
  CheckPose(file_, line(), subject, pose);
  return {begin, offset()};
}

void ColmapTextCursor::ExpectEndOfLine() {
  if (!AtEndOfLine()) FailHere("the end of the line");
}

void ColmapTextCursor::FailHere(const std::string& expected) {
  Fail("expected " + expected + ", found " + Quoted(Token("")));
}

namespace {

ColmapIndex::Sensor ReadSensor(ColmapTextCursor* cursor) {
  const std::string_view type = cursor->Token("a sensor type");
  if (type != "CAMERA" && type != "IMU") {
    cursor->Fail("expected a sensor type (CAMERA or IMU), found " + Quoted(type));
  }
  return {type == "CAMERA" ? SensorType::kCamera : SensorType::kImu, cursor->Id("a sensor id")};
}

void ScanCameras(ColmapIndex* index) {
  ColmapTextCursor cursor(index->cameras_file);
  while (cursor.NextRecord()) {
    const uint32_t id = cursor.Id("a camera id");
    const std::string subject = "camera " + std::to_string(id);
    const std::string_view name = cursor.Token("a camera model");
    const CameraModel* model = FindCameraModel(name);
    if (model == nullptr) {
      cursor.Fail(subject + ": expected the name of a COLMAP camera model, found " + Quoted(name));
    }
    const uint64_t width = cursor.Integer("an image width", kMaxPoint3DId);
    const uint64_t height = cursor.Integer("an image height", kMaxPoint3DId);
    CheckCameraSize(index->cameras_file, cursor.line(), subject, width, height);
    ColmapIndex::Camera camera{id, cursor.line(), model, width, height, {}, {}};
    camera.params_span.begin = cursor.NextTokenOffset();
    for (int i = 0; i < model->num_params; ++i) {
      if (cursor.AtEndOfLine()) {
        cursor.Fail(subject + ": expected " + std::to_string(model->num_params) +
                    " parameters of " + std::string(model->name) + ", found " + std::to_string(i));
      }
      camera.params[static_cast<size_t>(i)] = cursor.Number("a camera parameter");
    }
    camera.params_span.end = cursor.offset();
    cursor.ExpectEndOfLine();
    CheckCameraParams(index->cameras_file, cursor.line(), subject, *model, camera.params.data());
    index->cameras.push_back(camera);
  }
}

void ScanRigs(ColmapIndex* index) {
  ColmapTextCursor cursor(index->rigs_file);
  while (cursor.NextRecord()) {
    ColmapIndex::Rig rig{cursor.Id("a rig id"), cursor.line()};
    const std::string subject = "rig " + std::to_string(rig.id);
    const uint64_t num_sensors = cursor.Integer("a number of sensors", kInvalidColmapId);
    for (uint64_t j = 0; j < num_sensors; ++j) {
      rig.sensors.push_back(ReadSensor(&cursor));
      ColmapIndex::SensorPose& sensor = rig.poses.emplace_back();
      if (j == 0) continue;  // the reference sensor
      if (cursor.Integer("HAS_POSE", 1) == 1) {
        sensor.span = cursor.Pose(subject + ", sensor " + std::to_string(j), sensor.pose.data());
        sensor.is_known = true;
      }
    }
    cursor.ExpectEndOfLine();
    index->rigs.push_back(std::move(rig));
  }
}

void ScanFrames(ColmapIndex* index) {
  ColmapTextCursor cursor(index->frames_file);
  while (cursor.NextRecord()) {
    const uint32_t id = cursor.Id("a frame id");
    ColmapIndex::Frame frame{id, cursor.Id("a rig id"), cursor.line(), {}};
    frame.pose_span = cursor.Pose("frame " + std::to_string(id), frame.pose.data());
    const uint64_t num_data = cursor.Integer("a number of data", kInvalidColmapId);
    for (uint64_t j = 0; j < num_data; ++j) {
      const ColmapIndex::Sensor sensor = ReadSensor(&cursor);
      frame.data.push_back({sensor, cursor.Integer("a datum id", kInvalidPoint3DId)});
    }
    cursor.ExpectEndOfLine();
    index->frames.push_back(std::move(frame));
  }
}

}  // namespace

const ColmapScanner kColmapTextScanner = {ModelFile::Kind::kText, ".txt", ScanRigs, ScanCameras,
                                          ScanFrames};

}  // namespace bundle
