#pragma once

#include <exception>
#include <mutex>
#include <utility>

namespace bundle {

/// The first exception of several threads.
class FirstException {
 public:
  /// Inside a handler: keeps the exception that is being handled, unless there is one already.
  void Keep() noexcept {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!exception_) exception_ = std::current_exception();
  }

  /// Throws it, if there is one, and forgets it. When all threads have ended.
  void Rethrow() {
    if (exception_) std::rethrow_exception(std::exchange(exception_, nullptr));
  }

 private:
  std::mutex mutex_;
  std::exception_ptr exception_;
};

}  // namespace bundle
