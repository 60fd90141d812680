#pragma once

/// Parameters of a usual lens of each model, as tests/formulas.py has them.

#include <map>
#include <string>
#include <vector>

namespace bundle::testing {

inline std::vector<double> UsualParams(const CameraModel& model) {
  static const std::map<std::string, std::vector<double>> kExtra = {
      {"SIMPLE_PINHOLE", {}},
      {"PINHOLE", {}},
      {"SIMPLE_RADIAL", {-0.03}},
      {"RADIAL", {-0.05, 0.01}},
      {"OPENCV", {-0.05, 0.01, 0.001, -0.002}},
      {"OPENCV_FISHEYE", {-0.03, 0.01, -0.004, 0.001}},
      {"FULL_OPENCV", {-0.05, 0.01, 0.001, -0.002, 0.005, 0.02, -0.01, 0.003}},
      {"FOV", {0.9}},
      {"SIMPLE_RADIAL_FISHEYE", {-0.03}},
      {"RADIAL_FISHEYE", {-0.03, 0.01}},
      {"THIN_PRISM_FISHEYE", {-0.03, 0.01, 0.001, -0.002, -0.004, 0.001, 0.002, -0.001}},
      {"RAD_TAN_THIN_PRISM_FISHEYE",
       {-0.03, 0.01, -0.004, 0.001, 0.002, -0.0005, 0.001, -0.002, 0.002, -0.001, 0.001, 0.0005}},
      {"SIMPLE_DIVISION", {-0.08}},
      {"DIVISION", {-0.08}},
      {"SIMPLE_FISHEYE", {}},
      {"FISHEYE", {}},
      {"EUCM", {0.6, 1.1}},
      {"EQUIRECTANGULAR", {}}};
  const std::vector<double>& extra = kExtra.at(model.name);
  std::vector<double> params;
  int num_extra = 0;
  for (int j = 0; j < model.num_params; ++j) {
    const bool first = j == 0 || model.params[j - 1].kind != model.params[j].kind;
    switch (model.params[j].kind) {
      case CameraParam::kFocal:
        params.push_back(first ? 800 : 790);
        break;
      case CameraParam::kPrincipalPoint:
        params.push_back(first ? 400 : 300);
        break;
      case CameraParam::kMetadata:
        params.push_back(first ? 2000 : 1000);
        break;
      case CameraParam::kExtra:
        params.push_back(extra.at(num_extra++));
        break;
    }
  }
  return params;
}

}  // namespace bundle::testing
