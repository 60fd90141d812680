/// The module bundle._core, of all that the other files of this folder bind.

#include <pybind11/pybind11.h>

#include "core/error.h"
#include "core/prepare/memory.h"

namespace py = pybind11;

// One file per topic; each adds its functions to the module.
void BindCameras(py::module_& m);
void BindProblem(py::module_& m);
void BindBal(py::module_& m);
void BindJsonModels(py::module_& m);
void BindPointTracks(py::module_& m);
void BindColmap(py::module_& m);
void BindColmapRecords(py::module_& m);
void BindLosses(py::module_& m);
void BindScratch(py::module_& m);
void BindSolve(py::module_& m);
void BindCovariance(py::module_& m);
void BindRest(py::module_& m);
void BindCheck(py::module_& m);
void BindInspection(py::module_& m);
void BindDiagnosis(py::module_& m);
void BindSymbolic(py::module_& m);
void BindGraph(py::module_& m);
void BindInertial(py::module_& m);
void BindPoseGraph(py::module_& m);
void BindCertificate(py::module_& m);
void BindGraphCertainty(py::module_& m);
void BindWindow(py::module_& m);
void BindProcess(py::module_& m);
void BindLauncher(py::module_& m);
void BindSynthetic(py::module_& m);

PYBIND11_MODULE(_core, m) {
  m.doc() = "C++ core of bundle. Private: use the Python package.";
  m.attr("__version__") = BUNDLE_VERSION;
  py::register_exception<bundle::InputError>(m, "InputError", PyExc_ValueError);
  py::register_exception<bundle::NotEnoughMemoryError>(m, "NotEnoughMemoryError",
                                                       m.attr("InputError"));
  BindCameras(m);
  BindProblem(m);
  BindBal(m);
  BindJsonModels(m);
  BindPointTracks(m);
  BindColmap(m);
  BindColmapRecords(m);
  BindLosses(m);
  BindScratch(m);
  BindSolve(m);
  BindCovariance(m);
  BindRest(m);
  BindCheck(m);
  BindInspection(m);
  BindDiagnosis(m);
  BindSymbolic(m);
  BindGraph(m);
  BindInertial(m);
  BindPoseGraph(m);
  BindCertificate(m);
  BindGraphCertainty(m);
  BindWindow(m);
  BindProcess(m);
  BindLauncher(m);
  BindSynthetic(m);
}
