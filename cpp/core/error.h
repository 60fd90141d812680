#pragma once

#include <stdexcept>
#include <string>

namespace bundle {

/// Error that the user can fix: a malformed file, an array of the wrong shape, options that exclude
/// each other. `what()` is one line with the place, the expected and the found value.
class InputError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace bundle
