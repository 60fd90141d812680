#include "core/io/json_columns.h"

#include <rapidjson/stringbuffer.h>
#include <rapidjson/writer.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <memory>
#include <string_view>
#include <system_error>

#include "core/io/input_file.h"
#include "core/io/json_scanner.h"
#include "core/io/printable.h"

namespace bundle {
namespace {

using Kind = JsonShape::Kind;

bool IsOfNumbers(const JsonShape& shape) {
  return shape.kind == Kind::kNumbers || shape.kind == Kind::kColor;
}

std::string Expected(const JsonShape& shape) {
  switch (shape.kind) {
    case Kind::kRecord:
    case Kind::kMap:
      return "an object";
    case Kind::kList:
      return "an array";
    case Kind::kNumbers:
    case Kind::kColor:
      return std::to_string(shape.count) + " finite numbers";
    case Kind::kWhole:
      break;
  }
  return "a whole number from 0 to 4294967295";
}

/// Puts the values of one member into columns; skips it if there is no shape.
class ColumnCollector final : public JsonEvents {
 public:
  ColumnCollector(const JsonPosition& position, const JsonShape* shape)
      : position_(position), root_(shape), next_(shape) {}

  bool IsComplete() const { return has_begun_ && frames_.empty() && num_skipped_ == 0; }

  void Number(std::string_view text) override {
    if (const JsonShape* shape = TakeNext()) {
      if (IsEntryOf(*shape)) return AddNumber(*shape, text);
      if (shape->kind != Kind::kWhole) FailAt(*shape, "'" + Printable(text, kShown) + "'");
      uint32_t value = 0;
      if (!Parse(text, &value)) FailAt(*shape, "'" + Printable(text, kShown) + "'");
      shape->wholes->push_back(value);
    }
  }
  void String(std::string_view text) override { Refuse("'" + Printable(text, kShown) + "'"); }
  void Literal(std::string_view word) override { Refuse(std::string(word)); }

  void Key(std::string_view name) override {
    if (num_skipped_ > 0) return;
    Frame& frame = frames_.back();
    const JsonShape& shape = *frame.shape;
    if (shape.kind == Kind::kMap) {
      shape.names->text += name;
      shape.names->ends.push_back(static_cast<int64_t>(shape.names->text.size()));
      next_ = &shape.members[0];
      return;
    }
    next_ = nullptr;
    for (size_t k = 0; k < shape.members.size(); ++k) {
      if (shape.members[k].key != name) continue;
      if ((frame.seen >> k & 1) != 0) {
        position_.Fail(Place(), "each member once", "'" + shape.members[k].key + "' twice");
      }
      frame.seen |= 1U << k;
      next_ = &shape.members[k];
    }
  }

  void Begin(char bracket) override {
    const JsonShape* shape = TakeNext();
    if (shape == nullptr) {
      ++num_skipped_;
      return;
    }
    const bool is_object = shape->kind == Kind::kRecord || shape->kind == Kind::kMap;
    if (IsEntryOf(*shape) || shape->kind == Kind::kWhole || is_object != (bracket == '{')) {
      FailAt(*shape, bracket == '{' ? "an object" : "an array");
    }
    frames_.push_back({shape, 0, 0});
  }

  void End(char) override {
    if (num_skipped_ > 0) {
      --num_skipped_;
      return;
    }
    const Frame frame = frames_.back();
    const JsonShape& shape = *frame.shape;
    if (IsOfNumbers(shape) && frame.count != shape.count) {
      position_.Fail(Place(), Expected(shape), std::to_string(frame.count));
    }
    if (shape.kind == Kind::kRecord) Complete(frame);
    if (shape.kind == Kind::kList && shape.wholes != nullptr) shape.wholes->push_back(frame.count);
    frames_.pop_back();
    next_ = nullptr;
  }

 private:
  static constexpr size_t kShown = 40;  ///< bytes of a value in a message

  struct Frame {
    const JsonShape* shape;
    uint32_t count;  ///< entries so far, of a list or of numbers
    uint32_t seen;   ///< members so far, of a record: a bit each
  };

  /// The shape of the value that begins; null if it is skipped. Numbers of an array have its shape.
  const JsonShape* TakeNext() {
    has_begun_ = true;
    if (num_skipped_ > 0) return nullptr;
    const JsonShape* shape = next_;
    next_ = nullptr;
    if (frames_.empty()) return shape;
    Frame& frame = frames_.back();
    if (frame.shape->kind == Kind::kList) {
      ++frame.count;
      return &frame.shape->members[0];
    }
    if (IsOfNumbers(*frame.shape)) {
      ++frame.count;
      return frame.shape;
    }
    return shape;
  }

  bool IsEntryOf(const JsonShape& shape) const {
    return IsOfNumbers(shape) && !frames_.empty() && frames_.back().shape == &shape;
  }

  template <typename T>
  static bool Parse(std::string_view text, T* value) {
    const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), *value);
    return error == std::errc() && stop == text.data() + text.size();
  }

  void AddNumber(const JsonShape& shape, std::string_view text) {
    double value = 0;
    if (!Parse(text, &value) || !std::isfinite(value)) {
      FailAt(shape, "'" + Printable(text, kShown) + "'");
    }
    if (frames_.back().count > shape.count) return;  // refused at the end, which knows their number
    if (shape.kind == Kind::kNumbers) {
      shape.numbers->push_back(value);
    } else {
      shape.colors->push_back(static_cast<uint8_t>(std::nearbyint(std::clamp(value, 0.0, 255.0))));
    }
  }

  /// Refuses a record without a required member; fills optional ones with zeros.
  void Complete(const Frame& frame) {
    for (size_t k = 0; k < frame.shape->members.size(); ++k) {
      if ((frame.seen >> k & 1) != 0) continue;
      const JsonShape& member = frame.shape->members[k];
      if (member.is_required)
        position_.Fail(Place(), "a member " + member.key, "an object without it");
      if (member.kind == Kind::kColor) member.colors->resize(member.colors->size() + member.count);
    }
  }

  /// Refuses a text, true, false or null where a shape is expected.
  void Refuse(const std::string& found) {
    if (const JsonShape* shape = TakeNext()) FailAt(*shape, found);
  }

  [[noreturn]] void FailAt(const JsonShape& shape, const std::string& found) const {
    const bool is_member = !frames_.empty() && frames_.back().shape->kind == Kind::kRecord;
    position_.Fail(Place() + (is_member ? shape.key + ": " : ""), Expected(shape), found);
  }

  /// Names and numbers on the way to the last frame, each followed by ": ".
  std::string Place() const {
    std::string place;
    for (size_t k = 0; k < frames_.size(); ++k) {
      if (k == 0 || frames_[k - 1].shape->kind == Kind::kRecord) place += frames_[k].shape->key;
      const JsonShape& shape = *frames_[k].shape;
      if (shape.kind == Kind::kList) place += "[" + std::to_string(frames_[k].count - 1) + "]";
      if (shape.kind == Kind::kMap && !shape.names->ends.empty()) {
        const std::vector<int64_t>& ends = shape.names->ends;
        const auto begin = static_cast<size_t>(ends.size() > 1 ? ends[ends.size() - 2] : 0);
        place += ": " + Printable(shape.names->text.substr(begin), kShown);
      }
      if (!place.empty() && place.back() != ' ') place += ": ";
    }
    return frames_.empty() ? root_->key + ": " : place;
  }

  const JsonPosition& position_;
  const JsonShape* root_;
  const JsonShape* next_;  ///< shape of the value of the last key
  std::vector<Frame> frames_;
  bool has_begun_ = false;
  int num_skipped_ = 0;  ///< open brackets within a value that is skipped
};

/// Divides a file into a table and the rest.
class TableAndRest final : public JsonEvents {
 public:
  TableAndRest(const JsonPosition& position, const JsonTable& table)
      : position_(position), table_(table), rest_(text_) {}

  std::string Text() const { return {text_.GetString(), text_.GetSize()}; }

  void Number(std::string_view text) override {
    if (OfTable([&](JsonEvents& events) { events.Number(text); })) return;
    CountEntry();
    const bool is_infinite = text.back() == 'f';  // "Inf", which only RapidJSON reads
    const std::string whole = std::string(text) + (is_infinite ? "inity" : "");
    rest_.RawValue(whole.data(), whole.size(), rapidjson::kNumberType);
  }
  void String(std::string_view text) override {
    if (OfTable([&](JsonEvents& events) { events.String(text); })) return;
    CountEntry();
    rest_.String(text.data(), static_cast<rapidjson::SizeType>(text.size()), true);
  }
  void Literal(std::string_view word) override {
    if (OfTable([&](JsonEvents& events) { events.Literal(word); })) return;
    CountEntry();
    word == "null" ? rest_.Null() : rest_.Bool(word == "true");
  }
  void Key(std::string_view name) override {
    if (collector_ != nullptr) return collector_->Key(name);
    rest_.Key(name.data(), static_cast<rapidjson::SizeType>(name.size()), true);
    const int level = table_.entry < 0 ? 1 : 2;
    if (level_ != level || (table_.entry >= 0) != root_is_array_ || name != table_.shape.key) {
      return;
    }
    rest_.Null();
    const bool is_table = table_.entry < 0 || entry_ == table_.entry;
    if (is_table && was_read_) {
      position_.Fail("", "each member once", "'" + table_.shape.key + "' twice");
    }
    was_read_ |= is_table;
    collector_ = std::make_unique<ColumnCollector>(position_, is_table ? &table_.shape : nullptr);
  }
  void Begin(char bracket) override {
    if (OfTable([&](JsonEvents& events) { events.Begin(bracket); })) return;
    CountEntry();
    if (level_ == 0) root_is_array_ = bracket == '[';
    ++level_;
    bracket == '{' ? rest_.StartObject() : rest_.StartArray();
  }
  void End(char bracket) override {
    if (OfTable([&](JsonEvents& events) { events.End(bracket); })) return;
    --level_;
    bracket == '{' ? rest_.EndObject() : rest_.EndArray();
  }

 private:
  using Writer = rapidjson::Writer<rapidjson::StringBuffer>;

  /// Passes an event to the table if it is being read.
  template <typename Send>
  bool OfTable(Send send) {
    if (collector_ == nullptr) return false;
    send(*collector_);
    if (collector_->IsComplete()) collector_.reset();
    return true;
  }

  /// Counts the values of the array that is the root.
  void CountEntry() { entry_ += root_is_array_ && level_ == 1 ? 1 : 0; }

  const JsonPosition& position_;
  const JsonTable& table_;
  rapidjson::StringBuffer text_;
  Writer rest_;
  std::unique_ptr<ColumnCollector> collector_;
  int level_ = 0;
  int64_t entry_ = -1;  ///< number of the current entry of the root
  bool root_is_array_ = false;
  bool was_read_ = false;
};

}  // namespace

std::string ReadJsonColumns(const std::filesystem::path& path, const JsonTable& table,
                            const std::function<void()>& on_block) {
  const std::unique_ptr<InputFile> file = InputFile::Open(path);
  std::unique_ptr<TableAndRest> events;
  ScanJson(*file, on_block, [&](const JsonPosition& position) -> JsonEvents& {
    events = std::make_unique<TableAndRest>(position, table);
    return *events;
  });
  return events->Text();
}

}  // namespace bundle
