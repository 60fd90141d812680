#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/immutable_array.h"
#include "core/error.h"
#include "core/inertial/preintegration.h"
#include "core/inertial/propagation.h"

namespace py = pybind11;

namespace {

/// A row of numbers whose length the Python side has checked.
const double* RowOf(const CastArray<double>& array, py::ssize_t size, const char* what) {
  if (array.ndim() != 1 || array.shape(0) != size) {
    throw bundle::InputError(std::string(what) + ": expected " + std::to_string(size) +
                             " numbers, found " + std::to_string(array.size()));
  }
  return array.data();
}

bundle::IntegrationRule RuleFromName(const std::string& name) {
  if (name == "zero_order_hold") return bundle::IntegrationRule::kZeroOrderHold;
  if (name == "midpoint") return bundle::IntegrationRule::kMidpoint;
  throw bundle::InputError("rule: expected zero_order_hold or midpoint, found " + name);
}

std::string ShapeOf(const CastArray<double>& array) {
  std::string out = "(";
  for (py::ssize_t i = 0; i < array.ndim(); ++i) {
    out += (i > 0 ? ", " : "") + std::to_string(array.shape(i));
  }
  return out + (array.ndim() == 1 ? ",)" : ")");
}

/// The number of intervals of samples whose shapes match.
int CountSamples(const CastArray<double>& gyro, const CastArray<double>& accel,
                 const CastArray<double>& dt, bundle::IntegrationRule rule) {
  if (dt.ndim() != 1 || dt.size() > 1 << 28) {
    throw bundle::InputError("dt: expected shape (n,), found " + ShapeOf(dt));
  }
  const bool midpoint = rule == bundle::IntegrationRule::kMidpoint;
  const py::ssize_t rows = dt.size() + (midpoint ? 1 : 0);
  const char* const names[] = {"gyro", "accel"};
  const CastArray<double>* const arrays[] = {&gyro, &accel};
  for (int k = 0; k < 2; ++k) {
    if (arrays[k]->ndim() == 2 && arrays[k]->shape(0) == rows && arrays[k]->shape(1) == 3) continue;
    throw bundle::InputError(std::string(names[k]) + ": expected shape (" + std::to_string(rows) +
                             ", 3)" + (midpoint ? ", a sample at each end of an interval" : "") +
                             ", found " + ShapeOf(*arrays[k]));
  }
  return static_cast<int>(dt.size());
}

py::array Immutable(const double* numbers, std::vector<py::ssize_t> shape) {
  py::ssize_t size = 1;
  for (const py::ssize_t length : shape) size *= length;
  return ToImmutableNumpy(std::vector<double>(numbers, numbers + size), std::move(shape));
}

std::shared_ptr<bundle::Preintegration> MakePreintegration(const CastArray<double>& noise,
                                                           const CastArray<double>& gyro_bias,
                                                           const CastArray<double>& accel_bias,
                                                           const std::string& rule) {
  const double* n = RowOf(noise, 5, "noise");
  return std::make_shared<bundle::Preintegration>(
      bundle::ImuNoise{n[0], n[1], n[2], n[3], n[4]}, RowOf(gyro_bias, 3, "gyro_bias"),
      RowOf(accel_bias, 3, "accel_bias"), RuleFromName(rule));
}

constexpr py::ssize_t kNumbersOfSample = 10;  // dt, gyro, accel, accel_end

py::array SamplesOf(const bundle::Preintegration& motion) {
  std::vector<double> out;
  out.reserve(kNumbersOfSample * motion.samples().size());
  for (const bundle::ImuSample& sample : motion.samples()) {
    out.push_back(sample.dt);
    out.insert(out.end(), sample.gyro, sample.gyro + 3);
    out.insert(out.end(), sample.accel, sample.accel + 3);
    out.insert(out.end(), sample.accel_end, sample.accel_end + 3);
  }
  const auto count = static_cast<py::ssize_t>(motion.samples().size());
  return ToImmutableNumpy(std::move(out), {count, kNumbersOfSample});
}

void AppendSamples(bundle::Preintegration* motion, const CastArray<double>& rows) {
  if (rows.ndim() != 2 || rows.shape(1) != kNumbersOfSample) {
    throw bundle::InputError("samples: expected shape (n, 10), found " + ShapeOf(rows));
  }
  std::vector<bundle::ImuSample> samples(rows.shape(0));
  const double* row = rows.data();
  for (bundle::ImuSample& sample : samples) {
    sample.dt = row[0];
    for (int i = 0; i < 3; ++i) {
      sample.gyro[i] = row[1 + i];
      sample.accel[i] = row[4 + i];
      sample.accel_end[i] = row[7 + i];
    }
    row += kNumbersOfSample;
  }
  motion->Append(samples);
}

py::array Propagate(const CastArray<double>& state, const CastArray<double>& gravity,
                    const std::string& rule_name, const CastArray<double>& gyro,
                    const CastArray<double>& accel, const CastArray<double>& dt) {
  const bundle::IntegrationRule rule = RuleFromName(rule_name);
  const int count = CountSamples(gyro, accel, dt, rule);
  py::array_t<double> out({static_cast<py::ssize_t>(count), py::ssize_t{16}});
  bundle::PropagateStates(RowOf(state, 16, "state"), RowOf(gravity, 3, "gravity"), rule,
                          gyro.data(), accel.data(), dt.data(), count, out.mutable_data());
  return out;
}

}  // namespace

void BindInertial(py::module_& m) {
  using bundle::Preintegration;
  const auto matrix = [](const double* (Preintegration::*part)() const) {
    return [part](const Preintegration& motion) { return Immutable((motion.*part)(), {3, 3}); };
  };
  const auto vector = [](const double* (Preintegration::*part)() const) {
    return [part](const Preintegration& motion) { return Immutable((motion.*part)(), {3}); };
  };
  py::class_<Preintegration, std::shared_ptr<Preintegration>>(m, "Preintegration")
      .def(py::init(&MakePreintegration), py::arg("noise"), py::arg("gyro_bias"),
           py::arg("accel_bias"), py::arg("rule"))
      .def("integrate",
           [](Preintegration& motion, const CastArray<double>& gyro, const CastArray<double>& accel,
              const CastArray<double>& dt) {
             const int count = CountSamples(gyro, accel, dt, motion.rule());
             motion.Integrate(gyro.data(), accel.data(), dt.data(), count);
           })
      .def("append",
           [](Preintegration& motion, const Preintegration& next) { motion.Append(next); })
      .def("append_samples", [](Preintegration& motion,
                                const CastArray<double>& rows) { AppendSamples(&motion, rows); })
      .def("copy", [](const Preintegration& motion) { return Preintegration(motion); })
      .def("repropagated",
           [](const Preintegration& motion, const CastArray<double>& gyro_bias,
              const CastArray<double>& accel_bias) {
             return motion.Repropagated(RowOf(gyro_bias, 3, "gyro_bias"),
                                        RowOf(accel_bias, 3, "accel_bias"));
           })
      .def("corrected",
           [](const Preintegration& motion, const CastArray<double>& gyro_bias,
              const CastArray<double>& accel_bias) {
             double rotation[9], position[3], velocity[3];
             motion.Corrected(RowOf(gyro_bias, 3, "gyro_bias"), RowOf(accel_bias, 3, "accel_bias"),
                              rotation, position, velocity);
             return py::make_tuple(Immutable(rotation, {3, 3}), Immutable(velocity, {3}),
                                   Immutable(position, {3}));
           })
      .def("predict",
           [](const Preintegration& motion, const CastArray<double>& state,
              const CastArray<double>& gravity) {
             py::array_t<double> out(16);
             bundle::PredictState(motion, RowOf(state, 16, "state"), RowOf(gravity, 3, "gravity"),
                                  out.mutable_data());
             return out;
           })
      .def("combined_covariance",
           [](const Preintegration& motion) {
             std::vector<double> out(225);
             motion.CombinedCovariance(out.data());
             return ToImmutableNumpy(std::move(out), {15, 15});
           })
      .def_property_readonly("samples", &SamplesOf)
      .def_property_readonly("duration", &Preintegration::duration)
      .def_property_readonly("turned", &Preintegration::turned)
      .def_property_readonly("covariance",
                             [](const Preintegration& motion) {
                               return Immutable(motion.covariance().data(), {9, 9});
                             })
      .def_property_readonly("sqrt_information",
                             [](const Preintegration& motion) {
                               return Immutable(motion.sqrt_information().data(), {9, 9});
                             })
      .def_property_readonly("delta_rotation", matrix(&Preintegration::delta_rotation))
      .def_property_readonly("delta_velocity", vector(&Preintegration::delta_velocity))
      .def_property_readonly("delta_position", vector(&Preintegration::delta_position))
      .def_property_readonly("d_rotation_d_gyro_bias",
                             matrix(&Preintegration::d_rotation_d_gyro_bias))
      .def_property_readonly("d_velocity_d_gyro_bias",
                             matrix(&Preintegration::d_velocity_d_gyro_bias))
      .def_property_readonly("d_velocity_d_accel_bias",
                             matrix(&Preintegration::d_velocity_d_accel_bias))
      .def_property_readonly("d_position_d_gyro_bias",
                             matrix(&Preintegration::d_position_d_gyro_bias))
      .def_property_readonly("d_position_d_accel_bias",
                             matrix(&Preintegration::d_position_d_accel_bias));
  m.def("propagate", &Propagate, py::arg("state"), py::arg("gravity"), py::arg("rule"),
        py::arg("gyro"), py::arg("accel"), py::arg("dt"));
}
