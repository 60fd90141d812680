#pragma once

/// Communicator of ranks that Python connects (python/bundle/solving/ranks). The core sums and
/// broadcasts by calling three methods of a Python object with its buffers.

#include <pybind11/pybind11.h>

#include <cstdint>
#include <utility>

#include "bindings/gil.h"
#include "core/sums/communicator.h"

/// Methods of the object: sum_to_first(what, values), sum_double_doubles_to_first(what, sums,
/// errors) and broadcast(what, values, root); arrays are writable memoryviews of doubles, changed
/// in place. Attributes: rank and num_ranks. The solve raises the exceptions of these methods.
class PythonCommunicator final : public bundle::Communicator {
 public:
  explicit PythonCommunicator(pybind11::object ranks)
      : ranks_(std::move(ranks)),
        rank_(pybind11::cast<int>(ranks_.attr("rank"))),
        num_ranks_(pybind11::cast<int>(ranks_.attr("num_ranks"))) {}

  int rank() const override { return rank_; }
  int num_ranks() const override { return num_ranks_; }

  void SumToFirst(const char* what, double* values, int64_t count) override {
    const HoldGil held;
    ranks_.attr("sum_to_first")(what, View(values, count));
  }

  void SumDoubleDoubleToFirst(const char* what, double* sums, double* errors,
                              int64_t count) override {
    const HoldGil held;
    ranks_.attr("sum_double_doubles_to_first")(what, View(sums, count), View(errors, count));
  }

  void Broadcast(const char* what, double* values, int64_t count, int root) override {
    const HoldGil held;
    ranks_.attr("broadcast")(what, View(values, count), root);
  }

 private:
  static pybind11::memoryview View(double* values, int64_t count) {
    return pybind11::memoryview::from_buffer(values, {count}, {sizeof(double)});
  }

  const pybind11::object ranks_;
  const int rank_;
  const int num_ranks_;
};
