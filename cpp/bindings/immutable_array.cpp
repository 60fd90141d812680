#include "bindings/immutable_array.h"

namespace py = pybind11;

namespace {

/// The capsule's name identifies arrays made here. Other libraries may write to the memory of their
/// arrays.
constexpr const char* kOwnerName = "bundle.immutable_array";

void Release(void* array) { py::handle(static_cast<PyObject*>(array)).dec_ref(); }

}  // namespace

py::array Freeze(const py::array& array) {
  const py::capsule owner(array.inc_ref().ptr(), kOwnerName, &Release);
  const std::vector<py::ssize_t> shape(array.shape(), array.shape() + array.ndim());
  const std::vector<py::ssize_t> strides(array.strides(), array.strides() + array.ndim());
  py::array frozen(array.dtype(), shape, strides, array.data(), owner);
  frozen.attr("setflags")(py::arg("write") = false);
  return frozen;
}

bool IsImmutable(const py::array& array) {
  py::object owner = array;
  while (py::isinstance<py::array>(owner)) {
    const auto view = py::reinterpret_borrow<py::array>(owner);
    if (view.writeable()) return false;
    owner = view.base();
    if (!owner) return false;
  }
  return PyBytes_Check(owner.ptr()) || PyCapsule_IsValid(owner.ptr(), kOwnerName) != 0;
}
