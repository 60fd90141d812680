#pragma once

/// How a user ends a computation: asked for on the calling thread, thrown as Interrupted.

#include <chrono>
#include <exception>
#include <functional>

namespace bundle {

/// Thrown where a computation is left because the user asked for it.
class Interrupted : public std::exception {
 public:
  const char* what() const noexcept override { return "interrupted"; }
};

/// While it lives, long computations on this thread ask `requested` now and then whether the user
/// wants them to end, at most once in `between_looks`. Once it has said so, it is not asked again.
///
/// Known to the thread and not handed down: otherwise every linear solver and every pass over the
/// points would take an argument that has nothing to do with it. The innermost one counts.
class InterruptionScope {
 public:
  using Clock = std::chrono::steady_clock;

  explicit InterruptionScope(std::function<bool()> requested,
                             Clock::duration between_looks = std::chrono::milliseconds(200));
  ~InterruptionScope();
  InterruptionScope(const InterruptionScope&) = delete;
  InterruptionScope& operator=(const InterruptionScope&) = delete;

 private:
  friend bool InterruptionRequested();

  std::function<bool()> requested_;
  Clock::duration between_looks_;
  bool is_requested_ = false;
  Clock::time_point next_look_ = Clock::now();
  InterruptionScope* const outer_;
};

/// True if the user wants the computation on this thread to end; false on any thread without a
/// scope. Costs a look at the clock while it does not ask.
bool InterruptionRequested();

/// Throws Interrupted if the user wants the computation on this thread to end.
void ThrowIfInterrupted();

}  // namespace bundle
