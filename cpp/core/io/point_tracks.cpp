#include "core/io/point_tracks.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <string_view>

#include "core/io/input_file.h"
#include "core/io/line_cursor.h"
#include "core/io/text_cursor.h"

namespace bundle {
namespace {

bool IsFiniteNumber(double value) { return std::isfinite(value); }

class PointTracksReader {
 public:
  PointTracksReader(InputFile& file, int64_t num_lines, const std::function<void()>& on_block)
      : cursor_(file, on_block, num_lines + 1),
        most_(static_cast<double>(file.stored_size()) / 4) {}

  PointTracks Read(int64_t num_images, int64_t num_points) {
    for (int64_t point = 0; point < num_points; ++point) {
      if (point == kSample) ReserveLike(static_cast<double>(num_points) / kSample);
      for (int k = 0; k < 3; ++k) tracks_.points.push_back(Number("a coordinate of", point));
      for (int k = 0; k < 3; ++k) {
        const double value = Number("a colour of", point);
        tracks_.colors.push_back(static_cast<uint8_t>(std::lround(std::clamp(value, 0.0, 255.0))));
      }
      const int32_t num_views = Integer("the number of views of", point, 0, kMost);
      for (int32_t view = 0; view < num_views; ++view) {
        const auto most = static_cast<int32_t>(num_images - 1);
        tracks_.image.push_back(Integer("the image of a view of", point, 0, most));
        tracks_.key.push_back(Integer("the key of a view of", point, -1, kMost));
        tracks_.xy.push_back(Number("x of a view of", point));
        tracks_.xy.push_back(Number("y of a view of", point));
        tracks_.point.push_back(static_cast<int32_t>(point));
      }
    }
    tracks_.next = cursor_.Peek();
    tracks_.next_line = cursor_.line();
    return std::move(tracks_);
  }

 private:
  static constexpr int32_t kMost = std::numeric_limits<int32_t>::max();
  static constexpr int64_t kSample = 4096;  ///< points from which the size is extrapolated
  static constexpr double kMargin = 1.02;   ///< factor on the extrapolation

  /// Reserves space for `factor` times the points and observations so far.
  void ReserveLike(double factor) {
    const auto scaled = [&](size_t size) {
      return static_cast<size_t>(std::min(most_, kMargin * factor * static_cast<double>(size)));
    };
    tracks_.points.reserve(scaled(tracks_.points.size()));
    tracks_.colors.reserve(scaled(tracks_.colors.size()));
    tracks_.image.reserve(scaled(tracks_.image.size()));
    tracks_.point.reserve(scaled(tracks_.point.size()));
    tracks_.key.reserve(scaled(tracks_.key.size()));
    tracks_.xy.reserve(scaled(tracks_.xy.size()));
  }

  double Number(const char* what, int64_t point) {
    double value = 0;
    if (!cursor_.Read(&value, IsFiniteNumber)) Fail(what, point, "a finite number");
    return value;
  }

  int32_t Integer(const char* what, int64_t point, int32_t least, int32_t most) {
    int32_t value = 0;
    if (!cursor_.Read(&value, [&](int32_t v) { return least <= v && v <= most; })) {
      Fail(what, point,
           "a whole number from " + std::to_string(least) + " to " + std::to_string(most));
    }
    return value;
  }

  [[noreturn]] void Fail(const char* what, int64_t point, const std::string& expected) {
    cursor_.Fail(std::string(what) + " point " + std::to_string(point) + " (" + expected + ")");
  }

  TextCursor cursor_;
  double most_;  ///< numbers that the stored bytes make plausible
  PointTracks tracks_;
};

/// Positions of names: a table of slots with linear probing, at most half full. A lookup touches
/// two lines of memory; nodes of std::unordered_map take three, and eight times the memory.
class NameTable {
 public:
  explicit NameTable(const std::vector<std::string_view>& names) : names_(names) {
    while (mask_ < 2 * names.size()) mask_ = 2 * mask_ + 1;
    slots_.assign(mask_ + 1, -1);
    for (size_t k = 0; k < names.size(); ++k) {
      int32_t& slot = slots_[SlotOf(names[k])];
      if (slot < 0) slot = static_cast<int32_t>(k);
    }
  }

  /// -1 if there is no such name.
  int32_t Find(std::string_view name) const { return slots_[SlotOf(name)]; }

 private:
  /// The slot that has a name, or the empty slot for it.
  size_t SlotOf(std::string_view name) const {
    size_t slot = std::hash<std::string_view>()(name) & mask_;
    while (slots_[slot] >= 0 && names_[static_cast<size_t>(slots_[slot])] != name) {
      slot = (slot + 1) & mask_;
    }
    return slot;
  }

  const std::vector<std::string_view>& names_;
  size_t mask_ = 1;
  std::vector<int32_t> slots_;
};

class TracksCsvReader {
 public:
  TracksCsvReader(InputFile& file, const std::function<void()>& on_block)
      : cursor_(file, on_block) {}

  PointTracks Read(const std::vector<std::string_view>& images,
                   const std::vector<std::string_view>& tracks) {
    const NameTable image_places(images), track_places(tracks);
    std::string last_name;
    int32_t last_image = -1;
    for (int64_t record = 0; cursor_.NextLine(); ++record) {
      std::string_view line = cursor_.Line();
      while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.remove_suffix(1);
      if (line.empty()) continue;
      if (record == 0 && ReadVersion(line)) continue;
      Split(line);
      if (fields_[0] != last_name || record == 0) {
        last_name = fields_[0];
        last_image = image_places.Find(last_name);
      }
      const int32_t track = track_places.Find(fields_[1]);
      const auto key = Parsed<int32_t>(2, "the feature (a whole number)");
      const auto x = Parsed<double>(3, "x (a finite number)");
      const auto y = Parsed<double>(4, "y (a finite number)");
      const double scale = version_ > 0 ? Parsed<double>(5, "the scale (a finite number)") : 0.0;
      if (last_image < 0 || track < 0) {
        ++tracks_.num_skipped;
        continue;
      }
      tracks_.image.push_back(last_image);
      tracks_.point.push_back(track);
      tracks_.key.push_back(key);
      tracks_.xy.push_back(x);
      tracks_.xy.push_back(y);
      if (version_ > 0) tracks_.scale.push_back(scale);
    }
    return std::move(tracks_);
  }

 private:
  static constexpr std::string_view kVersion = "OPENSFM_TRACKS_VERSION_v";

  bool ReadVersion(std::string_view line) {
    if (line.substr(0, kVersion.size()) != kVersion) return false;
    const std::string_view version = line.substr(kVersion.size());
    if (version != "1" && version != "2") {
      cursor_.FailWith("version 1 or 2 of tracks.csv", Quoted(line));
    }
    version_ = version == "1" ? 1 : 2;
    return true;
  }

  void Split(std::string_view line) {
    const size_t expected = version_ == 0 ? 8 : version_ == 1 ? 9 : 11;
    size_t count = 0;
    for (size_t begin = 0;; ++count) {
      const size_t end = line.find('\t', begin);
      if (count < fields_.size()) fields_[count] = line.substr(begin, end - begin);
      if (end == std::string_view::npos) break;
      begin = end + 1;
    }
    ++count;
    if (count != expected) {
      cursor_.FailWith(std::to_string(expected) + " fields between tabs (version " +
                           std::to_string(version_) + " of tracks.csv)",
                       std::to_string(count));
    }
  }

  template <typename T>
  T Parsed(size_t field, const char* expected) {
    const std::string_view text = fields_[field];
    T value{};
    const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || stop != text.data() + text.size() ||
        !std::isfinite(static_cast<double>(value))) {
      cursor_.FailWith(expected, Quoted(text));
    }
    return value;
  }

  LineCursor cursor_;
  int version_ = 0;
  std::array<std::string_view, 11> fields_;
  PointTracks tracks_;
};

}  // namespace

PointTracks ReadPointTracks(const std::filesystem::path& path, int64_t skip, int64_t num_lines,
                            int64_t num_images, int64_t num_points,
                            const std::function<void()>& on_block) {
  const std::unique_ptr<InputFile> file = InputFile::Open(path);
  std::vector<char> skipped(kReadBlockSize);
  while (skip > 0) {
    const size_t count =
        file->Read(skipped.data(), std::min(skipped.size(), static_cast<size_t>(skip)));
    if (count == 0) FailAsChanged(file->name());
    skip -= static_cast<int64_t>(count);
  }
  return PointTracksReader(*file, num_lines, on_block).Read(num_images, num_points);
}

PointTracks ReadTracksCsv(const std::filesystem::path& path,
                          const std::vector<std::string_view>& images,
                          const std::vector<std::string_view>& tracks,
                          const std::function<void()>& on_block) {
  const std::unique_ptr<InputFile> file = InputFile::Open(path);
  return TracksCsvReader(*file, on_block).Read(images, tracks);
}

}  // namespace bundle
