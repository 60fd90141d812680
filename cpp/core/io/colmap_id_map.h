#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "core/io/colmap_index.h"

namespace bundle {

/// Position of a record by its id.
class IdMap {
 public:
  static constexpr int64_t kNone = -1;

  /// `record` is the kind of record, such as "camera". A repeated id is an error at the second
  /// record.
  template <typename Record>
  IdMap(const std::vector<Record>& records, const ModelFile& file, const std::string& record) {
    uint64_t max_id = 0;
    for (const Record& entry : records) max_id = std::max<uint64_t>(max_id, entry.id);
    // Ids are usually dense, and tracks look up an image for every observation.
    if (max_id < 16 * records.size() + 1024) dense_.assign(max_id + 1, kNone);
    for (size_t i = 0; i < records.size(); ++i) {
      const uint32_t id = records[i].id;
      const bool inserted = dense_.empty()
                                ? sparse_.emplace(id, i).second
                                : std::exchange(dense_[id], static_cast<int64_t>(i)) == kNone;
      if (!inserted) {
        file.Fail(records[i].at, "expected each " + record + " once, found " + record + " " +
                                     std::to_string(id) + " again");
      }
    }
  }

  int64_t Find(uint64_t id) const {
    if (!dense_.empty()) return id < dense_.size() ? dense_[id] : kNone;
    const auto found = sparse_.find(id);
    return found == sparse_.end() ? kNone : static_cast<int64_t>(found->second);
  }

 private:
  std::vector<int64_t> dense_;
  std::unordered_map<uint64_t, size_t> sparse_;
};

}  // namespace bundle
