#include "core/io/bal.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <system_error>
#include <vector>

#include "core/error.h"
#include "core/io/bal.h"
#include "support/damage.h"
#include "support/scene.h"
#include "support/temporary_folder.h"

namespace bundle {
namespace {

using testing::Damage;
using testing::MakeScene;
using testing::Scene;
using testing::SceneOptions;
using testing::TemporaryFolder;

template <typename T>
std::vector<T> Copied(const LargeVector<T>& values) {
  return {values.begin(), values.end()};
}

Scene BalScene() {
  SceneOptions options;
  options.model = "RADIAL";
  options.num_images = 3;
  options.num_points = 8;
  Scene scene = MakeScene(options);
  for (int c = 0; c < scene.num_cameras(); ++c) {
    scene.camera_params[Scene::kStride * c + 1] = 0;
    scene.camera_params[Scene::kStride * c + 2] = 0;
  }
  return scene;
}

std::filesystem::path Write(const Scene& scene, const std::filesystem::path& path,
                            Compression compression) {
  std::vector<double> params;
  for (int c = 0; c < scene.num_cameras(); ++c) {
    const double* row = &scene.camera_params[static_cast<size_t>(c) * Scene::kStride];
    params.insert(params.end(), row, row + 5);
  }
  const BalView view = {scene.num_images(),
                        scene.num_points(),
                        scene.num_observations(),
                        scene.cam_from_world.data(),
                        params.data(),
                        scene.points.data(),
                        scene.observation_image.data(),
                        scene.observation_point.data(),
                        scene.observation_xy.data()};
  WriteBal(view, path, compression, [] {});
  return path;
}

std::string Contents(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

/// Reads a file that may be damaged; what comes back, problem or complaint, has to be in order.
bool Reads(const std::filesystem::path& path) {
  try {
    const BalProblem problem = ReadBal(path, [] {});
    const auto num_images = static_cast<int32_t>(problem.cam_from_world.size() / 7);
    const auto num_points = static_cast<int32_t>(problem.points.size() / 3);
    EXPECT_EQ(problem.camera_params.size(), 5 * problem.cam_from_world.size() / 7);
    EXPECT_EQ(problem.observation_image.size(), problem.observation_point.size());
    EXPECT_EQ(problem.observation_xy.size(), 2 * problem.observation_point.size());
    for (const int32_t image : problem.observation_image) {
      EXPECT_TRUE(image >= 0 && image < num_images);
    }
    for (const int32_t point : problem.observation_point) {
      EXPECT_TRUE(point >= 0 && point < num_points);
    }
    const auto are_finite = [](const auto& values) {
      for (const double value : values) EXPECT_TRUE(std::isfinite(value));
    };
    are_finite(problem.cam_from_world);
    are_finite(problem.camera_params);
    are_finite(problem.points);
    are_finite(problem.observation_xy);
    return true;
  } catch (const InputError& error) {
    const std::string message = error.what();
    EXPECT_EQ(message.find('\n'), std::string::npos);
    EXPECT_LT(message.size(), 1000u);
    EXPECT_NE(message.find("expected"), std::string::npos) << message;
    EXPECT_NE(message.find("found"), std::string::npos) << message;
    return false;
  }
}

constexpr Compression kCompressions[] = {Compression::kNone, Compression::kGzip,
                                         Compression::kBzip2};

TEST(Bal, WhatIsWrittenIsRead) {
  const TemporaryFolder folder;
  const Scene scene = BalScene();
  for (const Compression compression : kCompressions) {
    const BalProblem read =
        ReadBal(Write(scene, folder.path() / "problem.txt", compression), nullptr);
    EXPECT_EQ(Copied(read.observation_image), scene.observation_image);
    EXPECT_EQ(Copied(read.observation_point), scene.observation_point);
    EXPECT_EQ(Copied(read.observation_xy), scene.observation_xy);
    EXPECT_EQ(Copied(read.points), scene.points);
    ASSERT_EQ(read.cam_from_world.size(), scene.cam_from_world.size());
    for (size_t i = 0; i < read.cam_from_world.size(); ++i) {
      EXPECT_NEAR(read.cam_from_world[i], scene.cam_from_world[i], 1e-15);
    }
  }
}

TEST(Bal, AFileThatIsCutEndsOrderly) {
  const TemporaryFolder folder;
  for (const Compression compression : kCompressions) {
    const std::string bytes =
        Contents(Write(BalScene(), folder.path() / "problem.txt", compression));
    EXPECT_TRUE(Reads(folder.path() / "problem.txt"));
    int num_read = 0;
    for (size_t size = 0; size < bytes.size(); size += 3) {
      num_read += Reads(folder.Write("short.txt", bytes.substr(0, size)));
    }
    // Text may lose its last newline and the last digits of its last number.
    EXPECT_LE(num_read, compression == Compression::kNone ? 9 : 0);
  }
}

TEST(Bal, DamageEndsOrderly) {
  const TemporaryFolder folder;
  for (const Compression compression : kCompressions) {
    const std::string bytes =
        Contents(Write(BalScene(), folder.path() / "problem.txt", compression));
    Damage damage(1);
    int num_refused = 0;
    for (int repeat = 0; repeat < 400; ++repeat) {
      SCOPED_TRACE(repeat);
      num_refused += !Reads(folder.Write("damaged.txt", damage.Next(bytes)));
    }
    EXPECT_GT(num_refused, 120);
  }
}

/// Tokens that straddle the reader's buffer of a megabyte, and one that does not fit.
TEST(Bal, BuffersEndAnywhere) {
  const TemporaryFolder folder;
  const std::string bytes =
      Contents(Write(BalScene(), folder.path() / "problem.txt", Compression::kNone));
  const size_t second_line = bytes.find('\n');
  for (size_t shift = 0; shift < 80; ++shift) {
    std::string padded = bytes;
    padded.insert(second_line, (size_t{1} << 20) - shift, ' ');
    EXPECT_TRUE(Reads(folder.Write("padded.txt", padded))) << shift;
  }
  std::string huge = bytes;
  huge.insert(second_line + 1, (size_t{1} << 20) + 5, '1');
  EXPECT_FALSE(Reads(folder.Write("huge.txt", huge)));
}

/// Headers that promise more than there is cost nothing.
TEST(Bal, PromisesCostNoMemory) {
  const TemporaryFolder folder;
  EXPECT_FALSE(Reads(folder.Write("a.txt", "2147483647 2147483647 2147483647\n0 0 1 1\n")));
  EXPECT_FALSE(Reads(folder.Write("b.txt", "1 1 2147483647\n0 0 1 1\n")));
  EXPECT_FALSE(Reads(folder.Write("c.txt", "2147483648 1 1\n")));
  EXPECT_FALSE(Reads(folder.Write("d.txt", "")));
  EXPECT_TRUE(Reads(folder.Write("e.txt", "0 0 0\n")));
}

TEST(Bal, WhatIsNoFileIsAnErrorOfTheSystem) {
  const TemporaryFolder folder;
  EXPECT_THROW(ReadBal(folder.path() / "nothing.txt", nullptr), std::system_error);
  EXPECT_THROW(ReadBal(folder.path(), nullptr), std::system_error);
  EXPECT_THROW(Write(BalScene(), folder.path() / "no" / "folder.txt", Compression::kGzip),
               std::system_error);
}

TEST(Bal, AnInterruptEndsTheReading) {
  const TemporaryFolder folder;
  const auto path = Write(BalScene(), folder.path() / "problem.txt", Compression::kNone);
  struct Interrupt {};
  EXPECT_THROW(ReadBal(path, [] { throw Interrupt(); }), Interrupt);
}

}  // namespace
}  // namespace bundle
