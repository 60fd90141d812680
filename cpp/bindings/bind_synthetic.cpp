#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/gil.h"
#include "bindings/immutable_array.h"
#include "core/cameras/registry.h"
#include "core/synthetic/visible_pairs.h"

namespace py = pybind11;

namespace bundle {
namespace {

/// Layout of the capsules of NumPy's bit generators (numpy/random/bitgen.h).
struct BitGenerator {
  void* state;
  uint64_t (*next_uint64)(void*);
  uint32_t (*next_uint32)(void*);
  double (*next_double)(void*);
  uint64_t (*next_raw)(void*);
};

/// The images of a scene. bundle.synthetic must check shapes and the range of indices.
class Images {
 public:
  Images(Array<double> centers, Array<double> rotations, Array<double> ball_centers,
         Array<double> ball_radii, Array<double> max_tangents, Array<double> sizes,
         Array<double> richness, Array<int32_t> cameras, Array<double> params,
         const std::string& model, double min_cosine, double pitch, double clearance) {
    view_.num_images = centers.shape(0);
    view_.num_params = static_cast<int>(params.shape(1));
    view_.model = FindCameraModel(model);
    view_.min_cosine = min_cosine;
    view_.pitch = pitch;
    view_.clearance = clearance;
    view_.centers = Keep(std::move(centers));
    view_.rotations = Keep(std::move(rotations));
    view_.ball_centers = Keep(std::move(ball_centers));
    view_.ball_radii = Keep(std::move(ball_radii));
    view_.max_tangents = Keep(std::move(max_tangents));
    view_.sizes = Keep(std::move(sizes));
    view_.richness = Keep(std::move(richness));
    view_.params = Keep(std::move(params));
    view_.cameras = cameras.data();
    kept_.push_back(std::move(cameras));
  }

  const SyntheticImages& view() const { return view_; }

 private:
  const double* Keep(Array<double> array) {
    const double* data = array.data();
    kept_.push_back(std::move(array));
    return data;
  }

  SyntheticImages view_;
  std::vector<py::object> kept_;
};

/// Pairs of all images.
py::tuple PairsOf(const Images& images, const Array<double>& positions,
                  const Array<double>& normals, const Array<double>& reach,
                  const Array<double>& keys, const Array<double>& cell_centers,
                  double half_diagonal, const Array<int64_t>& cell_starts,
                  const Array<int64_t>& order, const Array<double>& wanted, int64_t fewest,
                  const py::capsule& bit_generator, int num_threads) {
  const SyntheticPoints points{positions.shape(0), positions.data(), normals.data(), reach.data(),
                               keys.data()};
  const PointCells cells{cell_centers.shape(0), cell_centers.data(), half_diagonal,
                         cell_starts.data()};
  const auto* random = bit_generator.get_pointer<BitGenerator>();
  const int64_t* order_of_points = order.data();
  const double* wants = wanted.data();
  VisiblePairs pairs;
  {
    const ReleaseGil release;
    pairs = FindVisiblePairs(
        images.view(), points, cells, order_of_points, wants, fewest,
        [random] { return random->next_double(random->state); }, num_threads);
  }
  const auto count = static_cast<py::ssize_t>(pairs.point.size());
  return py::make_tuple(ToImmutableNumpy(std::move(pairs.point), {count}),
                        ToImmutableNumpy(std::move(pairs.image), {count}));
}

Array<double> ExactPixels(const Images& images, const Array<double>& positions,
                          const Array<int32_t>& image, const Array<int32_t>& point,
                          int num_threads) {
  const py::ssize_t count = image.size();
  Array<double> xy({count, py::ssize_t{2}});
  double* out = xy.mutable_data();
  const double* from = positions.data();
  const int32_t* of_image = image.data();
  const int32_t* of_point = point.data();
  const ReleaseGil release;
  ProjectExactly(images.view(), from, count, of_image, of_point, num_threads, out);
  return xy;
}

}  // namespace
}  // namespace bundle

void BindSynthetic(py::module_& m) {
  py::class_<bundle::Images>(m, "SyntheticImages")
      .def(py::init<Array<double>, Array<double>, Array<double>, Array<double>, Array<double>,
                    Array<double>, Array<double>, Array<int32_t>, Array<double>, const std::string&,
                    double, double, double>(),
           py::arg("centers"), py::arg("rotations"), py::arg("ball_centers"), py::arg("ball_radii"),
           py::arg("max_tangents"), py::arg("sizes"), py::arg("richness"), py::arg("cameras"),
           py::arg("params"), py::arg("model"), py::arg("min_cosine"), py::arg("pitch"),
           py::arg("clearance"))
      .def("visible_pairs", &bundle::PairsOf, py::arg("positions"), py::arg("normals"),
           py::arg("reach"), py::arg("keys"), py::arg("cell_centers"), py::arg("half_diagonal"),
           py::arg("cell_starts"), py::arg("order"), py::arg("wanted"), py::arg("fewest"),
           py::arg("bit_generator"), py::arg("num_threads"))
      .def("exact_pixels", &bundle::ExactPixels, py::arg("positions"), py::arg("observation_image"),
           py::arg("observation_point"), py::arg("num_threads"));
}
