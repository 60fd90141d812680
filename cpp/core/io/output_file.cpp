#include "core/io/output_file.h"

#include <bzlib.h>
#include <fcntl.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <cerrno>
#include <new>
#include <system_error>
#include <thread>
#include <utility>

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
  // The bound from libbz2's manual.
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

void OutputFile::Overwrite(int64_t position, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t count = pwrite(fd_, bytes.data(), bytes.size(), position);
    if (count >= 0) {
      bytes.remove_prefix(static_cast<size_t>(count));
      position += count;
    } else if (errno != EINTR) {
      ThrowSystemError();
    }
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

}  // namespace bundle
