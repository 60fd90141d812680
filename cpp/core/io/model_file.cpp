#include "core/io/model_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <new>
#include <utility>

#include "core/error.h"
#include "core/io/printable.h"

namespace bundle {
namespace {

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
  throw InputError(Printable(path) + ": expected a readable file, found: " + reason);
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
  const std::string path = Printable(path_);
  const std::string place = std::to_string(position);
  throw InputError((kind_ == Kind::kText ? path + ":" + place : path + ": byte " + place) + ": " +
                   message);
}

std::string Quoted(std::string_view text) {
  // Appended piece by piece: GCC 12 sees a phantom overlap in a chain of operator+ (-Wrestrict).
  std::string result = "'";
  result += Printable(text, kMaxQuotedLength);
  result += "'";
  return result;
}

}  // namespace bundle
