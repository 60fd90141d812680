#include <gtest/gtest.h>

#include <thread>

#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

TEST(Interruption, IsAskedForUntilItIsSo) {
  EXPECT_FALSE(InterruptionRequested());
  int asked = 0;
  {
    const InterruptionScope scope([&] { return ++asked > 0; });
    EXPECT_THROW(ThrowIfInterrupted(), Interrupted);
    EXPECT_THROW(ThrowIfInterrupted(), Interrupted);
    EXPECT_EQ(asked, 1);
    std::thread([] { EXPECT_FALSE(InterruptionRequested()); }).join();
    {
      const InterruptionScope inner([] { return false; });
      EXPECT_FALSE(InterruptionRequested());
    }
    EXPECT_TRUE(InterruptionRequested());
  }
  EXPECT_NO_THROW(ThrowIfInterrupted());
}

TEST(Interruption, IsNotAskedForAllTheTime) {
  int asked = 0;
  const InterruptionScope scope([&] { return ++asked < 0; });
  for (int i = 0; i < 1000; ++i) EXPECT_FALSE(InterruptionRequested());
  EXPECT_GE(asked, 1);
  EXPECT_LT(asked, 100);  // a second would be six
}

}  // namespace
}  // namespace bundle
