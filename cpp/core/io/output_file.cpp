#include "core/io/output_file.h"

#include <bzlib.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <new>
#include <system_error>
#include <thread>
#include <utility>

#include "core/error.h"
#include "core/io/input_file.h"

namespace bundle {

namespace {

std::string CompressGzip(const std::string& block) {
  constexpr int kGzipOnly = 15 + 16;
  constexpr int kDefaultMemory = 8;
  z_stream stream{};
  if (deflateInit2(&stream, Z_DEFAULT_COMPRESSION, Z_DEFLATED, kGzipOnly, kDefaultMemory,
                   Z_DEFAULT_STRATEGY) != Z_OK) {
    throw std::bad_alloc();
  }
  std::string compressed(deflateBound(&stream, block.size()), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(block.data()));
  stream.avail_in = static_cast<uInt>(block.size());
  stream.next_out = reinterpret_cast<Bytef*>(compressed.data());
  stream.avail_out = static_cast<uInt>(compressed.size());
  deflate(&stream, Z_FINISH);  // cannot fail: deflateBound is enough
  compressed.resize(stream.total_out);
  deflateEnd(&stream);
  return compressed;
}

std::string CompressBzip2(const std::string& block) {
  // The bound that libbz2's manual gives.
  std::string compressed(block.size() + block.size() / 100 + 600, '\0');
  auto size = static_cast<unsigned>(compressed.size());
  if (BZ2_bzBuffToBuffCompress(compressed.data(), &size, const_cast<char*>(block.data()),
                               static_cast<unsigned>(block.size()), 9, 0, 0) != BZ_OK) {
    throw std::bad_alloc();
  }
  compressed.resize(size);
  return compressed;
}

}  // namespace

OutputFile::OutputFile(const std::filesystem::path& path, Compression compression)
    : path_(path),
      compression_(compression),
      fd_(open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666)) {
  if (fd_ < 0) ThrowSystemError();
}

OutputFile::~OutputFile() {
  if (fd_ >= 0) close(fd_);
}

void OutputFile::Write(std::string_view block) {
  if (compression_ == Compression::kNone) {
    WriteToSystem(block);
    return;
  }
  while (streams_.size() > std::max(1u, std::thread::hardware_concurrency())) FinishOldestStream();
  const auto compress = compression_ == Compression::kGzip ? CompressGzip : CompressBzip2;
  std::string content(block);
  try {
    streams_.push_back(std::async(std::launch::async, compress, content));
  } catch (const std::system_error&) {  // the system has no more threads
    streams_.push_back(std::async(std::launch::deferred, compress, std::move(content)));
  }
}

void OutputFile::Close() {
  while (!streams_.empty()) FinishOldestStream();
  if (close(std::exchange(fd_, -1)) != 0) ThrowSystemError();
}

void OutputFile::FinishOldestStream() {
  const std::string stream = streams_.front().get();
  streams_.pop_front();
  WriteToSystem(stream);
}

void OutputFile::WriteToSystem(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t count = write(fd_, bytes.data(), bytes.size());
    if (count >= 0) {
      bytes.remove_prefix(static_cast<size_t>(count));
    } else if (errno != EINTR) {
      ThrowSystemError();
    }
  }
}

void OutputFile::ThrowSystemError() const {
  throw std::system_error(errno, std::generic_category(), path_.native());
}

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
