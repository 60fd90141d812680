#include "core/io/model_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <new>
#include <utility>

#include "core/error.h"

namespace bundle {
namespace {

constexpr size_t kMaxPathLength = 4096;
constexpr size_t kMaxQuotedLength = 40;

class FileDescriptor {
 public:
  explicit FileDescriptor(const std::string& path)
      : fd_(open(path.c_str(), O_RDONLY | O_CLOEXEC)) {}
  ~FileDescriptor() {
    if (fd_ >= 0) close(fd_);
  }
  FileDescriptor(const FileDescriptor&) = delete;
  FileDescriptor& operator=(const FileDescriptor&) = delete;

  int get() const { return fd_; }

 private:
  int fd_;
};

[[noreturn]] void FailToRead(const std::string& path, const std::string& reason) {
  throw InputError(Printable(path, kMaxPathLength) +
                   ": expected a readable file, found: " + reason);
}

/// Length of the UTF-8 sequence at the start of `text` (RFC 3629), 0 where there is none.
size_t Utf8SequenceLength(std::string_view text) {
  const auto byte = [&](size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned char lead = byte(0);
  const size_t length = lead < 0x80 ? 1 : lead < 0xC2 ? 0 : lead < 0xE0 ? 2 : lead < 0xF0 ? 3 : 4;
  if (length == 0 || lead > 0xF4 || text.size() < length) return 0;
  for (size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xC0) != 0x80) return 0;
  }
  if (lead == 0xE0 && byte(1) < 0xA0) return 0;  // overlong
  if (lead == 0xED && byte(1) > 0x9F) return 0;  // surrogate
  if (lead == 0xF0 && byte(1) < 0x90) return 0;  // overlong
  if (lead == 0xF4 && byte(1) > 0x8F) return 0;  // above U+10FFFF
  return length;
}

/// As Utf8SequenceLength, and 0 for the control characters of ASCII and Latin-1, for the two
/// separators that also end a line for Python (U+2028, U+2029) and for the byte order mark.
size_t PrintableLength(std::string_view text) {
  const size_t length = Utf8SequenceLength(text);
  const auto lead = static_cast<unsigned char>(text[0]);
  if (length == 1 && (lead < 0x20 || lead == 0x7F)) return 0;
  if (length == 2 && lead == 0xC2 && static_cast<unsigned char>(text[1]) < 0xA0) return 0;
  for (const char* hidden : {"\xE2\x80\xA8", "\xE2\x80\xA9", "\xEF\xBB\xBF"}) {
    if (text.substr(0, 3) == hidden) return 0;
  }
  return length;
}

}  // namespace

ModelFile::ModelFile(std::string path, Kind kind) : path_(std::move(path)), kind_(kind) {
  struct stat status;
  // Before open(), which would wait for a writer if this were a named pipe.
  if (stat(path_.c_str(), &status) != 0) FailToRead(path_, std::strerror(errno));
  if (!S_ISREG(status.st_mode)) FailToRead(path_, "not a regular file");
  const FileDescriptor file(path_);
  if (file.get() < 0) FailToRead(path_, std::strerror(errno));

  const auto size = static_cast<size_t>(status.st_size);
  contents_.reset(new (std::nothrow) char[size]);
  if (contents_ == nullptr) FailToRead(path_, std::to_string(size) + " bytes, more than memory");
  while (size_ < size) {
    const ssize_t count = read(file.get(), contents_.get() + size_, size - size_);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) FailToRead(path_, std::strerror(errno));
    if (count == 0) break;  // shortened while we read
    size_ += static_cast<size_t>(count);
  }
}

void ModelFile::Release() {
  contents_.reset();
  size_ = 0;
}

void ModelFile::Fail(uint64_t position, const std::string& message) const {
  const std::string path = Printable(path_, kMaxPathLength);
  const std::string place = std::to_string(position);
  throw InputError((kind_ == Kind::kText ? path + ":" + place : path + ": byte " + place) + ": " +
                   message);
}

bool IsPrintable(std::string_view text) {
  while (!text.empty()) {
    const size_t length = PrintableLength(text);
    if (length == 0) return false;
    text.remove_prefix(length);
  }
  return true;
}

std::string Printable(std::string_view text, size_t max_length) {
  static constexpr char kHexDigits[] = "0123456789abcdef";
  std::string result;
  while (!text.empty()) {
    if (result.size() >= max_length) return result + "...";
    const size_t length = PrintableLength(text);
    if (length == 0) {
      const auto byte = static_cast<unsigned char>(text[0]);
      result += {'\\', 'x', kHexDigits[byte >> 4], kHexDigits[byte & 15]};
    } else {
      result += text.substr(0, length);
    }
    text.remove_prefix(length == 0 ? 1 : length);
  }
  return result;
}

std::string Quoted(std::string_view text) {
  // Appended piece by piece: GCC 12 sees a phantom overlap in a chain of operator+ (-Wrestrict).
  std::string result = "'";
  result += Printable(text, kMaxQuotedLength);
  result += "'";
  return result;
}

}  // namespace bundle
