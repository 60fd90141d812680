#include "core/io/json_scanner.h"

#include <rapidjson/error/en.h>
#include <rapidjson/reader.h>

#include <algorithm>
#include <vector>

namespace bundle {
namespace {

constexpr int kMostLevels = 200;  ///< deepest nesting; Python's parser reads no more than 1000

/// The bytes of a file for RapidJSON, which reads a zero at the end.
class ByteStream {
 public:
  using Ch = char;

  ByteStream(InputFile& file, const std::function<void()>& on_block)
      : file_(file), on_block_(on_block), buffer_(kReadBlockSize + 1) {
    next_ = end_ = buffer_.data();
    Refill();
  }

  Ch Peek() const { return *next_; }
  Ch Take() {
    const Ch taken = *next_;
    if (next_ < end_ && ++next_ == end_) Refill();
    return taken;
  }
  size_t Tell() const { return before_ + static_cast<size_t>(next_ - buffer_.data()); }
  bool AtEnd() const { return next_ == end_; }

  /// Number of the line under the cursor.
  int64_t Line() const { return lines_ + std::count<const char*>(buffer_.data(), next_, '\n'); }

  // Writing, which a parser in place would do.
  Ch* PutBegin() { return nullptr; }
  void Put(Ch) {}
  void Flush() {}
  size_t PutEnd(Ch*) { return 0; }

 private:
  void Refill() {
    if (on_block_) on_block_();
    before_ += static_cast<size_t>(end_ - buffer_.data());
    lines_ += std::count<const char*>(buffer_.data(), end_, '\n');
    const size_t count = file_.Read(buffer_.data(), kReadBlockSize);
    next_ = buffer_.data();
    end_ = next_ + count;
    buffer_[count] = '\0';
  }

  InputFile& file_;
  const std::function<void()>& on_block_;
  std::vector<char> buffer_;
  const char* next_;
  const char* end_;
  size_t before_ = 0;  ///< bytes before the buffer
  int64_t lines_ = 1;  ///< number of the line at the start of the buffer
};

/// RapidJSON's handler: forwards events and counts the position.
class Handler final : public JsonPosition {
 public:
  Handler(const InputFile& file, const ByteStream& stream) : file_(file), stream_(stream) {}
  void SetEvents(JsonEvents& events) { events_ = &events; }

  std::string Where() const override { return file_.name() + ":" + std::to_string(stream_.Line()); }

  bool Null() { return Literal("null"); }
  bool Bool(bool value) { return Literal(value ? "true" : "false"); }
  bool RawNumber(const char* text, rapidjson::SizeType size, bool) {
    events_->Number({text, size});
    return true;
  }
  bool String(const char* text, rapidjson::SizeType size, bool) {
    events_->String({text, size});
    return true;
  }
  bool Key(const char* text, rapidjson::SizeType size, bool) {
    events_->Key({text, size});
    return true;
  }
  bool StartObject() { return Begin('{'); }
  bool StartArray() { return Begin('['); }
  bool EndObject(rapidjson::SizeType) { return End('{'); }
  bool EndArray(rapidjson::SizeType) { return End('['); }

  // Not called: numbers stay text.
  bool Int(int) { return false; }
  bool Uint(unsigned) { return false; }
  bool Int64(int64_t) { return false; }
  bool Uint64(uint64_t) { return false; }
  bool Double(double) { return false; }

 private:
  bool Literal(std::string_view word) {
    events_->Literal(word);
    return true;
  }
  bool Begin(char bracket) {
    if (++level_ > kMostLevels) {
      Fail("", "JSON of at most " + std::to_string(kMostLevels) + " levels", "more");
    }
    events_->Begin(bracket);
    return true;
  }
  bool End(char bracket) {
    --level_;
    events_->End(bracket);
    return true;
  }

  const InputFile& file_;
  const ByteStream& stream_;
  JsonEvents* events_ = nullptr;
  int level_ = 0;
};

}  // namespace

void ScanJson(InputFile& file, const std::function<void()>& on_block,
              const std::function<JsonEvents&(const JsonPosition&)>& events) {
  // Numbers stay text: std::from_chars reads them exactly, and what is not needed is not converted.
  constexpr unsigned kFlags =
      rapidjson::kParseNumbersAsStringsFlag | rapidjson::kParseIterativeFlag |
      rapidjson::kParseValidateEncodingFlag | rapidjson::kParseNanAndInfFlag;
  ByteStream stream(file, on_block);
  Handler handler(file, stream);
  handler.SetEvents(events(handler));
  rapidjson::Reader reader;
  const rapidjson::ParseResult result = reader.Parse<kFlags>(stream, handler);
  if (!result.IsError() && stream.AtEnd()) return;
  if (result.IsError() && stream.AtEnd()) handler.Fail("", "JSON", "the end of the file");
  std::string reason = "a zero byte";
  if (result.IsError()) reason = rapidjson::GetParseError_En(result.Code());
  if (reason.back() == '.') reason.pop_back();
  handler.Fail("", "JSON", "an error (" + reason + ")");
}

}  // namespace bundle
