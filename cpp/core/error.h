#pragma once

#include <stdexcept>
#include <string>

namespace bundle {

/// Something the user can put right: a malformed file, an array of the wrong shape, options that
/// exclude each other. `what()` is one line that says where, what was expected and what was found.
class InputError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace bundle
