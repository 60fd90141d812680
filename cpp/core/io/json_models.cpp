#include "core/io/json_models.h"

#include <charconv>
#include <system_error>
#include <utility>

namespace bundle {
namespace {

using Kind = JsonShape::Kind;

JsonShape Shape(Kind kind, std::string key) {
  JsonShape shape;
  shape.kind = kind;
  shape.key = std::move(key);
  return shape;
}

JsonShape Record(std::string key, std::vector<JsonShape> members) {
  JsonShape shape = Shape(Kind::kRecord, std::move(key));
  shape.members = std::move(members);
  return shape;
}

/// `lengths`: column of the numbers of entries; may be null.
JsonShape List(std::string key, JsonShape entry, std::vector<uint32_t>* lengths) {
  JsonShape shape = Shape(Kind::kList, std::move(key));
  shape.wholes = lengths;
  shape.members.push_back(std::move(entry));
  return shape;
}

JsonShape Map(std::string key, JsonShape entry, JsonNames* names) {
  JsonShape shape = Shape(Kind::kMap, std::move(key));
  shape.names = names;
  shape.members.push_back(std::move(entry));
  return shape;
}

JsonShape Numbers(std::string key, uint32_t count, std::vector<double>* column) {
  JsonShape shape = Shape(Kind::kNumbers, std::move(key));
  shape.count = count;
  shape.numbers = column;
  return shape;
}

JsonShape Whole(std::string key, std::vector<uint32_t>* column) {
  JsonShape shape = Shape(Kind::kWhole, std::move(key));
  shape.wholes = column;
  return shape;
}

JsonShape OptionalColor(std::string key, std::vector<uint8_t>* column) {
  JsonShape shape = Shape(Kind::kColor, std::move(key));
  shape.is_required = false;
  shape.count = 3;
  shape.colors = column;
  return shape;
}

/// The names as whole numbers of at most 17 digits; empty if one is not.
std::vector<int64_t> AsNumbers(const JsonNames& names) {
  std::vector<int64_t> numbers;
  numbers.reserve(names.ends.size());
  const char* begin = names.text.data();
  for (const int64_t offset : names.ends) {
    const char* const end = names.text.data() + offset;
    int64_t number = -1;
    const auto [stop, error] = std::from_chars(begin, end, number);
    if (error != std::errc() || stop != end || *begin == '-' || end - begin > 17) return {};
    numbers.push_back(number);
    begin = end;
  }
  return numbers;
}

}  // namespace

OpenMvgStructure ReadOpenMvg(const std::filesystem::path& path,
                             const std::function<void()>& on_block) {
  OpenMvgStructure found;
  JsonTable table;
  const JsonShape observation =
      Record("", {Whole("key", &found.view),
                  Record("value", {Whole("id_feat", &found.feature), Numbers("x", 2, &found.xy)})});
  const JsonShape landmark =
      Record("", {Whole("key", &found.ids),
                  Record("value", {Numbers("X", 3, &found.points),
                                   List("observations", observation, &found.num_views)})});
  table.shape = List("structure", landmark, nullptr);
  found.rest = ReadJsonColumns(path, table, on_block);
  return found;
}

OpenSfmPoints ReadOpenSfm(const std::filesystem::path& path, int64_t entry,
                          const std::function<void()>& on_block) {
  OpenSfmPoints found;
  JsonTable table;
  table.entry = entry;
  table.shape = Map(
      "points",
      Record("", {Numbers("coordinates", 3, &found.points), OptionalColor("color", &found.colors)}),
      &found.names);
  found.rest = ReadJsonColumns(path, table, on_block);
  found.ids = AsNumbers(found.names);
  return found;
}

}  // namespace bundle
