#pragma once

/// Memory in files, for arrays of problems that are larger than the memory.
///
/// A process has at most one scratch folder. While it is open, large arrays (large_vector.h) are
/// allocated in files there, which are mapped into memory. The files have no names, so that the
/// system removes them with the process, however it ends. Their blocks are allocated at once: a
/// disk that is too small is an error of the allocation, not of an access later.
///
/// Pages in memory are bounded by a thread that unmaps all of them when they exceed the limit. For
/// shared mappings of files this loses nothing, at any time and in any thread: the next access
/// takes the page from the system's cache or from the disk. The system writes changed pages and
/// drops pages of the cache as it needs memory. Passes over points access the arrays in order, so
/// that the system reads ahead.

#include <cstddef>
#include <cstdint>
#include <string>

namespace bundle {

/// Allocates the following large arrays in files below `folder`, of which about `resident_bytes`
/// are in memory at a time. Throws InputError if the folder cannot have such files or if another
/// one is open.
void OpenScratch(const std::string& folder, int64_t resident_bytes);

/// Allocates the following large arrays in memory again. Existing arrays keep their files until
/// they are freed, and the bound holds for them.
void CloseScratch();

/// Bytes of the pages that may be in memory at a time; -1: no folder is open.
int64_t ScratchResidentBytes();

/// Bytes of all files so far: now, and at most.
struct ScratchUse {
  int64_t bytes = 0;
  int64_t peak_bytes = 0;
};
ScratchUse MeasureScratch();

/// Memory in a file; nullptr if no folder is open or the size is below a page. Contents are zeros
/// or those of freed memory. Throws InputError if the disk is too small.
void* AllocateScratch(size_t size);

/// Frees the memory of AllocateScratch. Returns false if it is from elsewhere.
bool FreeScratch(void* memory, size_t size);

}  // namespace bundle
