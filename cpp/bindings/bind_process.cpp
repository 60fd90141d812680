#include <pybind11/pybind11.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <exception>
#include <new>

namespace py = pybind11;

namespace {

std::terminate_handler previous_handler = nullptr;

/// Ends the process if a thread of another library, such as Ceres', gets no memory. Allocates
/// nothing; at this time, no file of the user is open for writing.
[[noreturn]] void Terminate() {
  try {
    if (std::current_exception()) throw;
  } catch (const std::bad_alloc&) {
    constexpr char kLine[] = "error: not enough memory\n";
    [[maybe_unused]] const ssize_t written = write(STDERR_FILENO, kLine, std::strlen(kLine));
    _exit(2);
  } catch (...) {
  }
  previous_handler();
  std::abort();
}

}  // namespace

void BindProcess(py::module_& m) {
  m.def("end_in_one_line", [] {
    if (previous_handler == nullptr) previous_handler = std::set_terminate(Terminate);
  });
}
