#include "core/io/input_file.h"

#include <bzlib.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <system_error>
#include <utility>
#include <vector>

#include "core/error.h"
#include "core/io/printable.h"

namespace bundle {

namespace {

/// The file as stored. Its first bytes can be inspected before they are read, also in a pipe.
class RawFile {
 public:
  explicit RawFile(const std::filesystem::path& path)
      : path_(path),
        name_(Printable(path.native())),
        fd_(open(path.c_str(), O_RDONLY | O_CLOEXEC)) {
    if (fd_ < 0) ThrowSystemError();
    struct stat status{};
    if (fstat(fd_, &status) != 0) {
      const int error = errno;
      close(fd_);
      errno = error;
      ThrowSystemError();
    }
    if (S_ISREG(status.st_mode)) size_ = static_cast<uint64_t>(status.st_size);
  }
  ~RawFile() {
    if (fd_ >= 0) close(fd_);
  }
  RawFile(RawFile&& other) noexcept
      : path_(std::move(other.path_)),
        name_(std::move(other.name_)),
        fd_(std::exchange(other.fd_, -1)),
        size_(other.size_),
        head_(std::move(other.head_)) {}
  RawFile& operator=(RawFile&&) = delete;

  bool StartsWith(std::string_view magic) {
    while (head_.size() < magic.size()) {
      char byte = 0;
      if (ReadFromSystem(&byte, 1) == 0) return false;
      head_ += byte;
    }
    return std::string_view(head_).substr(0, magic.size()) == magic;
  }

  void SkipByteOrderMark() {
    if (StartsWith(kByteOrderMark)) head_.erase(0, kByteOrderMark.size());
  }

  size_t Read(char* buffer, size_t size) {
    if (head_.empty()) return ReadFromSystem(buffer, size);
    const size_t taken = head_.copy(buffer, size);
    head_.erase(0, taken);
    return taken;
  }

  const std::string& name() const { return name_; }
  uint64_t size() const { return size_; }

 private:
  size_t ReadFromSystem(char* buffer, size_t size) {
    ssize_t count = 0;
    do {
      count = read(fd_, buffer, size);
    } while (count < 0 && errno == EINTR);
    if (count < 0) ThrowSystemError();
    return static_cast<size_t>(count);
  }

  [[noreturn]] void ThrowSystemError() const {
    throw std::system_error(errno, std::generic_category(), path_.native());
  }

  std::filesystem::path path_;
  std::string name_;
  int fd_;
  uint64_t size_ = 0;
  std::string head_;
};

class PlainFile final : public InputFile {
 public:
  explicit PlainFile(RawFile raw) : raw_(std::move(raw)) {}
  size_t Read(char* buffer, size_t size) override { return raw_.Read(buffer, size); }
  const std::string& name() const override { return raw_.name(); }
  uint64_t stored_size() const override { return raw_.size(); }
  bool is_compressed() const override { return false; }

 private:
  RawFile raw_;
};

/// Outcome of one call of a decoder.
enum class Decoded { kSome, kEndOfStream, kDamaged };

struct GzipDecoder {
  static constexpr const char* kFormat = "gzip";
  static constexpr std::string_view kMagic = "\x1f\x8b";

  GzipDecoder() {
    constexpr int kGzipOnly = 15 + 16;
    if (inflateInit2(&stream, kGzipOnly) != Z_OK) throw std::bad_alloc();
  }
  ~GzipDecoder() { inflateEnd(&stream); }
  void Restart() { inflateReset(&stream); }
  Decoded Decode() {
    const int status = inflate(&stream, Z_NO_FLUSH);
    if (status == Z_MEM_ERROR) throw std::bad_alloc();
    if (status == Z_STREAM_END) return Decoded::kEndOfStream;
    return status == Z_OK || status == Z_BUF_ERROR ? Decoded::kSome : Decoded::kDamaged;
  }
  void SetInput(char* data, size_t size) {
    stream.next_in = reinterpret_cast<Bytef*>(data);
    stream.avail_in = static_cast<uInt>(size);
  }
  void SetOutput(char* data, size_t size) {
    stream.next_out = reinterpret_cast<Bytef*>(data);
    stream.avail_out = static_cast<uInt>(size);
  }
  z_stream stream{};
};

struct Bzip2Decoder {
  static constexpr const char* kFormat = "bzip2";
  static constexpr std::string_view kMagic = "BZh";

  Bzip2Decoder() { Begin(); }
  ~Bzip2Decoder() { BZ2_bzDecompressEnd(&stream); }
  void Restart() {
    const bz_stream last = stream;
    BZ2_bzDecompressEnd(&stream);
    Begin();
    stream.next_in = last.next_in;
    stream.avail_in = last.avail_in;
    stream.next_out = last.next_out;
    stream.avail_out = last.avail_out;
  }
  Decoded Decode() {
    const int status = BZ2_bzDecompress(&stream);
    if (status == BZ_MEM_ERROR) throw std::bad_alloc();
    if (status == BZ_STREAM_END) return Decoded::kEndOfStream;
    return status == BZ_OK ? Decoded::kSome : Decoded::kDamaged;
  }
  void SetInput(char* data, size_t size) {
    stream.next_in = data;
    stream.avail_in = static_cast<unsigned>(size);
  }
  void SetOutput(char* data, size_t size) {
    stream.next_out = data;
    stream.avail_out = static_cast<unsigned>(size);
  }
  void Begin() {
    stream = {};
    if (BZ2_bzDecompressInit(&stream, 0, 0) != BZ_OK) throw std::bad_alloc();
  }
  bz_stream stream{};
};

template <typename Decoder>
class CompressedFile final : public InputFile {
 public:
  explicit CompressedFile(RawFile raw) : raw_(std::move(raw)), input_(size_t{1} << 18) {}

  size_t Read(char* buffer, size_t size) override {
    size = std::min(size, size_t{1} << 30);
    decoder_.SetOutput(buffer, size);
    while (decoder_.stream.avail_out == size) {
      if (decoder_.stream.avail_in == 0) Refill();
      if (between_streams_ && !BeginStream()) return 0;
      const auto left_before = decoder_.stream.avail_in;
      switch (decoder_.Decode()) {
        case Decoded::kEndOfStream:
          between_streams_ = true;
          break;
        case Decoded::kDamaged:
          Fail("intact data", "damage");
        case Decoded::kSome:
          const bool stuck =
              decoder_.stream.avail_in == left_before && decoder_.stream.avail_out == size;
          if (stuck && at_end_) Fail("more data", "the end of the file");
      }
    }
    return size - decoder_.stream.avail_out;
  }
  const std::string& name() const override { return raw_.name(); }
  uint64_t stored_size() const override { return raw_.size(); }
  bool is_compressed() const override { return true; }

 private:
  void Refill() {
    const size_t count = raw_.Read(input_.data(), input_.size());
    offset_ += count;
    at_end_ = count == 0;
    decoder_.SetInput(input_.data(), count);
  }

  /// Begins the next of several concatenated streams; returns false at the end of the file.
  bool BeginStream() {
    if (decoder_.stream.avail_in == 0) return false;
    if (static_cast<char>(*decoder_.stream.next_in) != Decoder::kMagic[0]) {
      Fail("another stream or the end of the file", "other data");
    }
    decoder_.Restart();
    between_streams_ = false;
    return true;
  }

  [[noreturn]] void Fail(const char* expected, const char* found) const {
    throw InputError(raw_.name() + ": " + Decoder::kFormat + " data at byte " +
                     std::to_string(offset_ - decoder_.stream.avail_in) + ": expected " + expected +
                     ", found " + found);
  }

  RawFile raw_;
  std::vector<char> input_;
  uint64_t offset_ = 0;  ///< bytes read from the file so far
  bool at_end_ = false;
  bool between_streams_ = false;
  Decoder decoder_;
};

}  // namespace

std::unique_ptr<InputFile> InputFile::Open(const std::filesystem::path& path) {
  RawFile raw(path);
  if (raw.StartsWith(GzipDecoder::kMagic)) {
    return std::make_unique<CompressedFile<GzipDecoder>>(std::move(raw));
  }
  if (raw.StartsWith(Bzip2Decoder::kMagic)) {
    return std::make_unique<CompressedFile<Bzip2Decoder>>(std::move(raw));
  }
  raw.SkipByteOrderMark();
  return std::make_unique<PlainFile>(std::move(raw));
}

void FailAsChanged(const std::string& name) {
  throw InputError((name.empty() ? name : name + ": ") +
                   "the input file has changed while it was in use");
}

}  // namespace bundle
