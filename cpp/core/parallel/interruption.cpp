#include "core/parallel/interruption.h"

#include <utility>

namespace bundle {
namespace {

// In the thread's own static block: worker threads look too, and memory for a variable of a module
// that was loaded late would be allocated then, where a failure ends the process.
__attribute__((tls_model("initial-exec"))) thread_local InterruptionScope* innermost = nullptr;

}  // namespace

InterruptionScope::InterruptionScope(std::function<bool()> requested, Clock::duration between_looks)
    : requested_(std::move(requested)),
      between_looks_(between_looks),
      outer_(std::exchange(innermost, this)) {}

InterruptionScope::~InterruptionScope() { innermost = outer_; }

bool InterruptionRequested() {
  InterruptionScope* const scope = innermost;
  if (scope == nullptr) return false;
  const auto now = InterruptionScope::Clock::now();
  if (!scope->is_requested_ && now >= scope->next_look_) {
    scope->is_requested_ = scope->requested_();
    scope->next_look_ = now + scope->between_looks_;
  }
  return scope->is_requested_;
}

void ThrowIfInterrupted() {
  if (InterruptionRequested()) throw Interrupted();
}

}  // namespace bundle
