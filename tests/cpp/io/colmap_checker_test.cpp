#include "core/io/colmap_checker.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <string>
#include <tuple>
#include <vector>

#include "core/error.h"
#include "core/io/colmap_index.h"
#include "core/io/colmap_model.h"
#include "support/colmap_files.h"
#include "support/damage.h"
#include "support/scene.h"
#include "support/temporary_folder.h"

namespace bundle {
namespace {

using testing::Damage;
using testing::Files;
using testing::MakeScene;
using testing::Scene;
using testing::SceneOptions;
using testing::TemporaryFolder;

/// Every camera model, a shared camera, a keypoint twice in a track, an image and a point alone.
Scene ModelScene() {
  Scene scene;
  for (int m = 0; m < kNumCameraModels; ++m) {
    SceneOptions options;
    options.model = AllCameraModels()[m].name;
    options.num_images = 1;
    options.num_points = 2;
    options.seed = static_cast<uint64_t>(m) + 1;
    Scene piece = MakeScene(options);
    piece.image_ids[0] += 2 * m - 1'000'000 * (m > 0);
    piece.camera_ids[0] += 2 * m - 1'000'000 * (m > 0);
    for (int64_t& id : piece.point_ids) id += 4 * m - 1'000'000 * (m > 0);
    if (m == 0) {
      scene = piece;
    } else {
      testing::Append(piece, &scene);
    }
  }
  testing::RepeatObservations(5, &scene);
  testing::AddUnobserved(&scene);
  return scene;
}

void Write(const Files& files, const TemporaryFolder& folder) {
  for (const auto& [name, bytes] : files) folder.Write(name, bytes);
}

ColmapObservations Observations(const ColmapIndex& index) {
  return SortColmapObservations(index, CheckColmapReferences(index));
}

/// Checks a model that may be damaged; what comes back has to be in order.
bool Accepts(const TemporaryFolder& folder) {
  try {
    ReadColmapModel(folder.path().string());
    const ColmapObservations observations = Observations(ScanColmapModel(folder.path().string()));
    EXPECT_EQ(observations.image.size(), observations.point.size());
    EXPECT_EQ(observations.image.size(), observations.keypoint.size());
    EXPECT_EQ(2 * observations.image.size(), observations.xy.size());
    return true;
  } catch (const InputError& error) {
    const std::string message = error.what();
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
    EXPECT_LT(message.size(), 1000u);
    EXPECT_NE(message.find("expected"), std::string::npos) << message;
    EXPECT_NE(message.find("found"), std::string::npos) << message;
    return false;
  }
}

std::vector<Files> BothFormats(const Scene& scene) {
  return {testing::BinaryColmapFiles(scene), testing::TextColmapFiles(scene)};
}

TEST(ColmapChecker, GivesTheObservationsOfASoundModel) {
  const Scene scene = ModelScene();
  using Row = std::tuple<int32_t, int32_t, int32_t, double, double>;  // point, image, keypoint, xy
  std::vector<Row> expected;
  std::vector<int32_t> num_keypoints(scene.num_images());
  for (int64_t i = 0; i < scene.num_observations(); ++i) {
    const int32_t image = scene.observation_image[i];
    expected.emplace_back(scene.observation_point[i], image, num_keypoints[image]++,
                          scene.observation_xy[2 * i], scene.observation_xy[2 * i + 1]);
  }
  std::sort(expected.begin(), expected.end());  // ids ascend with indices
  for (const Files& files : BothFormats(scene)) {
    const TemporaryFolder folder;
    Write(files, folder);
    const ColmapIndex index = ScanColmapModel(folder.path().string());
    EXPECT_EQ(index.kind == ModelFile::Kind::kBinary, files.count("cameras.bin") == 1);
    const ColmapObservations observations = Observations(index);
    std::vector<Row> found;
    for (size_t i = 0; i < observations.image.size(); ++i) {
      found.emplace_back(observations.point[i], observations.image[i], observations.keypoint[i],
                         observations.xy[2 * i], observations.xy[2 * i + 1]);
    }
    EXPECT_EQ(found, expected);
  }
}

TEST(ColmapChecker, AcceptsAModelWithoutRigsAndFrames) {
  for (Files files : BothFormats(ModelScene())) {
    const TemporaryFolder folder;
    for (const char* name : {"rigs.bin", "frames.bin", "rigs.txt", "frames.txt"}) files.erase(name);
    Write(files, folder);
    EXPECT_TRUE(Accepts(folder));
  }
}

TEST(ColmapChecker, AFileThatIsCutEndsOrderly) {
  for (const Files& files : BothFormats(ModelScene())) {
    const TemporaryFolder folder;
    for (const auto& [name, bytes] : files) {
      Write(files, folder);
      // Every length near both ends, a sample between.
      for (size_t size = 0; size < bytes.size();
           size += size < 200 || size + 200 > bytes.size() ? 1 : 13) {
        SCOPED_TRACE(::testing::Message() << name << " " << size);
        folder.Write(name, bytes.substr(0, size));
        const bool accepted = Accepts(folder);
        EXPECT_FALSE(accepted && name.find(".bin") != std::string::npos);
      }
    }
  }
}

TEST(ColmapChecker, DamageEndsOrderly) {
  for (const Files& files : BothFormats(ModelScene())) {
    const TemporaryFolder folder;
    for (const auto& [name, bytes] : files) {
      Write(files, folder);
      Damage damage(std::hash<std::string>()(name));
      int num_refused = 0;
      for (int repeat = 0; repeat < 500; ++repeat) {
        SCOPED_TRACE(::testing::Message() << name << " " << repeat);
        folder.Write(name, damage.Next(bytes));
        num_refused += !Accepts(folder);
      }
      EXPECT_GT(num_refused, 150) << name;
    }
  }
}

TEST(ColmapChecker, SeveralFilesDamagedAtOnce) {
  for (const Files& files : BothFormats(ModelScene())) {
    const TemporaryFolder folder;
    Damage damage(7);
    for (int repeat = 0; repeat < 300; ++repeat) {
      SCOPED_TRACE(repeat);
      for (const auto& [name, bytes] : files) folder.Write(name, damage.Next(bytes));
      Accepts(folder);
    }
  }
}

TEST(ColmapChecker, AFolderWithoutAModelIsNamed) {
  const TemporaryFolder folder;
  EXPECT_FALSE(Accepts(folder));
  EXPECT_THROW(ReadColmapModel((folder.path() / "none").string()), InputError);
  EXPECT_THROW(ReadColmapModel(""), InputError);
}

}  // namespace
}  // namespace bundle
