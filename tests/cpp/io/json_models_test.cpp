#include "core/io/json_models.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "core/error.h"
#include "support/damage.h"
#include "support/temporary_folder.h"

namespace bundle {
namespace {

using testing::Damage;
using testing::TemporaryFolder;

/// Members in other orders than OpenMVG's, members that are not read, escapes, and both forms of
/// numbers.
constexpr const char* kMvg = R"({"structure": [
 {"value": {"observations": [{"value": {"x": [1.5, -2e1], "id_feat": 7, "more": [{"x": 1}]},
                              "key": 3}],
            "X": [1, 2.5, -3]}, "key": 4294967295},
 {"key": 0, "value": {"X": [0, 0, 1e-3], "observations": []}}],
 "root": "a\u00e9\"\\", "n": [1, -0.5, NaN, -Infinity, true, null, {}], "X": {"structure": 3}})";

constexpr const char* kSfm = R"([{"points": {"5": {"coordinates": [9, 9, 9]}}, "a": 1},
 {"shots": {"points": {}}, "points": {
   "12": {"color": [300, -1, 2.5], "coordinates": [1, 2, 3], "x": [[1], {"y": 2}]},
   "x\ty": {"coordinates": [4, 5, 6]}}}])";

class JsonModels : public ::testing::Test {
 protected:
  OpenMvgStructure Mvg(const std::string& text) {
    return ReadOpenMvg(folder_.Write("a.json", text), {});
  }
  OpenSfmPoints Sfm(const std::string& text, int64_t entry) {
    return ReadOpenSfm(folder_.Write("a.json", text), entry, {});
  }

  /// Message of the error, from the name of the file.
  std::string ErrorOfSfm(const std::string& text) {
    try {
      Sfm(text, 0);
    } catch (const InputError& error) {
      return std::string(error.what()).substr(std::string(error.what()).find("a.json"));
    }
    return "no error";
  }

  TemporaryFolder folder_;
};

TEST_F(JsonModels, ColumnsAndRestOfOpenMvg) {
  const OpenMvgStructure found = Mvg(kMvg);
  EXPECT_EQ(found.ids, (std::vector<uint32_t>{4294967295, 0}));
  EXPECT_EQ(found.points, (std::vector<double>{1, 2.5, -3, 0, 0, 1e-3}));
  EXPECT_EQ(found.num_views, (std::vector<uint32_t>{1, 0}));
  EXPECT_EQ(found.view, std::vector<uint32_t>{3});
  EXPECT_EQ(found.feature, std::vector<uint32_t>{7});
  EXPECT_EQ(found.xy, (std::vector<double>{1.5, -20}));
  EXPECT_EQ(
      found.rest,
      "{\"structure\":null,\"root\":\"a\u00e9\\\"\\\\\",\"n\":[1,-0.5,NaN,-Infinity,true,null,"
      "{}],\"X\":{\"structure\":3}}");
}

TEST_F(JsonModels, OneReconstructionOfOpenSfm) {
  const OpenSfmPoints found = Sfm(kSfm, 1);
  EXPECT_EQ(found.names.text, "12x\ty");
  EXPECT_EQ(found.names.ends, (std::vector<int64_t>{2, 5}));
  EXPECT_TRUE(found.ids.empty());
  EXPECT_EQ(found.points, (std::vector<double>{1, 2, 3, 4, 5, 6}));
  EXPECT_EQ(found.colors, (std::vector<uint8_t>{255, 0, 2, 0, 0, 0}));
  EXPECT_EQ(found.rest, "[{\"points\":null,\"a\":1},{\"shots\":{\"points\":{}},\"points\":null}]");
  EXPECT_EQ(Sfm(kSfm, 0).ids, std::vector<int64_t>{5});
  EXPECT_TRUE(Sfm(kSfm, 2).names.ends.empty());
}

TEST_F(JsonModels, ErrorsNameLineAndPlace) {
  const std::string at = "a.json:1: points: 7: coordinates: expected 3 finite numbers, found ";
  const auto point = [](const std::string& coordinates) {
    return R"([{"points": {"7": {"coordinates": )" + coordinates + "}}}]";
  };
  EXPECT_EQ(ErrorOfSfm(point("[1, 2]")), at + "2");
  EXPECT_EQ(ErrorOfSfm(point("[1, 2, 3, 4]")), at + "4");
  EXPECT_EQ(ErrorOfSfm(point("[1, 2, \"3\"]")), at + "'3'");
  EXPECT_EQ(ErrorOfSfm(point("[1, 2, [3]]")), at + "an array");
  EXPECT_EQ(ErrorOfSfm(point("[1, 2, NaN]")), at + "'NaN'");
  EXPECT_EQ(ErrorOfSfm(point("{}")), at + "an object");
  EXPECT_EQ(ErrorOfSfm(point("null")), at + "null");
  EXPECT_EQ(ErrorOfSfm(R"([{"points": {"7": {}}}])"),
            "a.json:1: points: 7: expected a member coordinates, found an object without it");
  EXPECT_EQ(ErrorOfSfm("[{\n\n\"points\": 3}]"), "a.json:3: points: expected an object, found '3'");
  EXPECT_EQ(ErrorOfSfm("[{\"points\": {},\n \"points\": {}}]"),
            "a.json:2: expected each member once, found 'points' twice");
  EXPECT_EQ(ErrorOfSfm("[{\"points\": {},\n"),
            "a.json:2: expected JSON, found the end of the file");
  EXPECT_EQ(ErrorOfSfm("[\n{,"),
            "a.json:2: expected JSON, found an error (Missing a name for object member)");
  EXPECT_EQ(ErrorOfSfm(std::string("[]\0[]", 5)),
            "a.json:1: expected JSON, found an error (a zero byte)");
  EXPECT_EQ(ErrorOfSfm(std::string(300, '[')),
            "a.json:1: expected JSON of at most 200 levels, found more");
  EXPECT_EQ(ErrorOfSfm(""), "a.json:1: expected JSON, found the end of the file");
}

TEST_F(JsonModels, DamagedFilesGiveColumnsOfOneLengthOrAnError) {
  Damage damage(5);
  for (int round = 0; round < 400; ++round) {
    try {
      const OpenMvgStructure found = Mvg(damage.Next(kMvg));
      size_t count = 0;
      for (const uint32_t views : found.num_views) count += views;
      EXPECT_EQ(found.points.size(), 3 * found.ids.size());
      EXPECT_EQ(found.num_views.size(), found.ids.size());
      EXPECT_EQ(found.view.size(), count);
      EXPECT_EQ(found.feature.size(), count);
      EXPECT_EQ(found.xy.size(), 2 * count);
    } catch (const InputError&) {
    }
    try {
      const OpenSfmPoints found = Sfm(damage.Next(kSfm), 1);
      EXPECT_EQ(found.points.size(), 3 * found.names.ends.size());
      EXPECT_EQ(found.colors.size(), 3 * found.names.ends.size());
    } catch (const InputError&) {
    }
  }
}

}  // namespace
}  // namespace bundle
