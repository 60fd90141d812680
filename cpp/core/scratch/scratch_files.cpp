#include "core/scratch/scratch_files.h"

/// Large arrays have a file each. Smaller ones, of which a plan has tens of thousands, share the
/// files of a *segment* that is freed with the last of them: the number of mappings of a process is
/// limited.

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>
#ifdef __linux__
#include <linux/magic.h>
#include <sys/vfs.h>
#endif

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <map>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>

#include "core/error.h"

namespace bundle {
namespace {

constexpr size_t kSmallest = 4096, kSegment = size_t{1} << 26, kAlignment = 64;
constexpr size_t kLargestInSegment = kSegment / 8;
// A disk of 2.4 GB/s brings 5 MB in between.
constexpr std::chrono::milliseconds kBetweenLooks(2);

[[noreturn]] void Fail(const std::string& folder, const std::string& expected, int error) {
  throw InputError(folder + ": expected " + expected + ", found \"" +
                   std::generic_category().message(error) + "\"");
}

/// Pages of files in the memory of this process, in bytes; 0 if the system does not report it.
int64_t MappedBytesInMemory() {
  const int file = open("/proc/self/statm", O_RDONLY | O_CLOEXEC);
  if (file < 0) return 0;
  char text[128] = {};
  const ssize_t count = read(file, text, sizeof(text) - 1);
  close(file);
  long long total = 0, resident = 0, shared = 0;
  if (count <= 0 || std::sscanf(text, "%lld %lld %lld", &total, &resident, &shared) != 3) return 0;
  return shared * sysconf(_SC_PAGESIZE);
}

bool IsInMemory(int file) {
#ifdef __linux__
  struct statfs system{};
  return fstatfs(file, &system) == 0 &&
         (system.f_type == TMPFS_MAGIC || system.f_type == RAMFS_MAGIC);
#else
  return file < 0;
#endif
}

class ScratchFiles {
 public:
  void Open(const std::string& folder, int64_t resident_bytes) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (is_open_) throw InputError(folder + ": expected one scratch folder, found two");
    folder_ = folder;
    const int file = Create();  // the first error is of the folder
    const bool is_in_memory = IsInMemory(file);
    close(file);
    if (is_in_memory) {
      throw InputError(folder + ": expected a folder on a disk, found a file system in memory");
    }
    limit_ = resident_bytes;
    other_bytes_ = mappings_.empty() ? MappedBytesInMemory() : other_bytes_;
    peak_bytes_ = bytes_;
    is_open_ = true;
    if (!std::exchange(is_watched_, true)) std::thread([this] { Watch(); }).detach();
  }

  void Close() {
    const std::lock_guard<std::mutex> lock(mutex_);
    is_open_ = false;
    current_ = nullptr;
    DropEmptySegments();
  }

  int64_t limit() const { return is_open_ ? limit_.load() : -1; }
  ScratchUse use() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return {bytes_, peak_bytes_};
  }

  void* Allocate(size_t size) {
    if (!is_open_ || size < kSmallest) return nullptr;
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!is_open_) return nullptr;
    if (size > kLargestInSegment) return Map(size);
    const size_t rounded = (size + kAlignment - 1) / kAlignment * kAlignment;
    if (current_ == nullptr || mappings_[current_].used + rounded > kSegment) {
      current_ = Map(kSegment);
      DropEmptySegments();
    }
    Mapping& segment = mappings_[current_];
    char* const memory = current_ + segment.used;
    segment.used += rounded;
    ++segment.num_arrays;
    return memory;
  }

  bool Free(void* memory, size_t size) {
    if (size < kSmallest || !has_mappings_) return false;
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto after = mappings_.upper_bound(static_cast<char*>(memory));
    if (after == mappings_.begin()) return false;
    const auto at = std::prev(after);
    if (static_cast<char*>(memory) >= at->first + at->second.size) return false;
    if (--at->second.num_arrays <= 0 && at->first != current_) Unmap(at->first);
    return true;
  }

 private:
  struct Mapping {
    size_t size = 0;
    size_t used = 0;     ///< bytes of arrays in a segment
    int num_arrays = 0;  ///< 0 for an array with a file of its own
  };

  /// A file without a name.
  int Create() const {
#ifdef O_TMPFILE
    const int unnamed = open(folder_.c_str(), O_TMPFILE | O_RDWR | O_EXCL | O_CLOEXEC, 0600);
    if (unnamed >= 0) return unnamed;
    if (errno != EOPNOTSUPP && errno != EISDIR) Fail(folder_, "a writable folder", errno);
#endif
    std::string name = folder_ + "/bundle_scratch_XXXXXX";
    const int file = mkstemp(name.data());
    if (file < 0) Fail(folder_, "a writable folder", errno);
    unlink(name.c_str());
    return file;
  }

  char* Map(size_t size) {
    const int file = Create();
#ifdef __linux__
    const int error = posix_fallocate(file, 0, static_cast<off_t>(size));
#else
    const int error = ftruncate(file, static_cast<off_t>(size)) == 0 ? 0 : errno;
#endif
    void* const memory =
        error == 0 ? mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0) : MAP_FAILED;
    const int reason = error == 0 ? errno : error;
    close(file);
    if (memory == MAP_FAILED) {
      const std::string megabytes = std::to_string((size + 999999) / 1000000);
      Fail(folder_, "room for a scratch file of " + megabytes + " MB", reason);
    }
    char* const begin = static_cast<char*>(memory);
    mappings_[begin].size = size;
    has_mappings_ = true;
    wake_.notify_all();
    bytes_ += static_cast<int64_t>(size);
    peak_bytes_ = std::max(peak_bytes_, bytes_);
    return begin;
  }

  void Unmap(char* begin) {
    const auto at = mappings_.find(begin);
    munmap(begin, at->second.size);
    bytes_ -= static_cast<int64_t>(at->second.size);
    mappings_.erase(at);
    has_mappings_ = !mappings_.empty();
  }

  void DropEmptySegments() {
    for (auto at = mappings_.begin(); at != mappings_.end();) {
      const auto next = std::next(at);
      const bool is_empty = at->second.used > 0 && at->second.num_arrays == 0;
      if (is_empty && at->first != current_) Unmap(at->first);
      at = next;
    }
  }

  /// Never ends, as the process may go on to another folder.
  [[noreturn]] void Watch() {
    std::unique_lock<std::mutex> lock(mutex_);
    for (;;) {
      wake_.wait(lock, [this] { return has_mappings_.load(); });
      wake_.wait_for(lock, kBetweenLooks);
      if (MappedBytesInMemory() - other_bytes_ <= limit_) continue;
      for (const auto& [begin, mapping] : mappings_) madvise(begin, mapping.size, MADV_DONTNEED);
    }
  }

  std::mutex mutex_;
  std::condition_variable wake_;
  std::string folder_;
  std::map<char*, Mapping> mappings_;
  char* current_ = nullptr;  ///< the segment that is filled
  int64_t bytes_ = 0, peak_bytes_ = 0;
  int64_t other_bytes_ = 0;  ///< pages of other files, such as libraries
  std::atomic<int64_t> limit_{0};
  std::atomic<bool> is_open_{false}, has_mappings_{false};
  bool is_watched_ = false;
};

/// Not destroyed: arrays may be freed at the very end of the process.
ScratchFiles& Files() {
  static ScratchFiles* const files = new ScratchFiles;
  return *files;
}

}  // namespace

void OpenScratch(const std::string& folder, int64_t resident_bytes) {
  Files().Open(folder, resident_bytes);
}

void CloseScratch() { Files().Close(); }

int64_t ScratchResidentBytes() { return Files().limit(); }

ScratchUse MeasureScratch() { return Files().use(); }

void* AllocateScratch(size_t size) { return Files().Allocate(size); }

bool FreeScratch(void* memory, size_t size) { return Files().Free(memory, size); }

}  // namespace bundle
