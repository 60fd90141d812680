#pragma once

/// The large part of a JSON file as columns, and the rest of the file as text.
///
/// Reconstructions in JSON are large in one member only, an array or object of equal records. Its
/// shape, a JsonShape, says where each value goes. The records never exist as objects: memory is
/// that of the columns.

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace bundle {

/// Texts in one block.
struct JsonNames {
  std::string text;
  std::vector<int64_t> ends;  ///< end of each text
};

/// Expected form of a value. Members of records that no shape names are skipped.
struct JsonShape {
  enum class Kind {
    kRecord,   ///< an object with `members`
    kList,     ///< an array of `members[0]`; its length is appended to `wholes`, unless null
    kMap,      ///< an object of `members[0]` by name; names are appended to `names`
    kNumbers,  ///< an array of `count` finite numbers, appended to `numbers`
    kColor,    ///< an array of `count` numbers, clamped and rounded to `colors`
    kWhole,    ///< a whole number below 2^32, appended to `wholes`
  };
  Kind kind = Kind::kRecord;
  std::string key;          ///< name as a member of a record
  bool is_required = true;  ///< as a member of a record; otherwise zeros if it is missing
  uint32_t count = 0;
  std::vector<double>* numbers = nullptr;
  std::vector<uint8_t>* colors = nullptr;
  std::vector<uint32_t>* wholes = nullptr;
  JsonNames* names = nullptr;
  std::vector<JsonShape> members;
};

/// The member that becomes columns: `shape.key` of the root, or, with `entry` >= 0, of the entry of
/// the array that is the root. The same member of other entries is skipped.
struct JsonTable {
  int64_t entry = -1;
  JsonShape shape;
};

/// Fills the columns of the table; returns the text of the rest of the file, where null takes the
/// place of the table's member.
///
/// @param on_block called between blocks of about a megabyte; may throw to end the reading.
/// Throws InputError with line and place for contents that are not JSON, or of another shape.
std::string ReadJsonColumns(const std::filesystem::path& path, const JsonTable& table,
                            const std::function<void()>& on_block);

}  // namespace bundle
