"""The example that checks cost functions in a C++ test: built as a user does, and run."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import bundle
from tests.examples.test_check_cost_function import WARNINGS, build, run

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "check_in_cpp"

MORE = r"""
#include <bundle/check.h>
#include <ceres/dynamic_cost_function.h>

#include <cmath>
#include <cstring>
#include <iostream>
#include <stdexcept>

struct Spoiled final : ceres::DynamicCostFunction {
  explicit Spoiled(const char* how) : how_(how) {
    AddParameterBlock(2);
    AddParameterBlock(1);
    SetNumResiduals(2);
  }
  bool Evaluate(double const* const* p, double* r, double** j) const override {
    const double a = p[0][0], b = p[0][1], c = p[1][0];
    if (Is("behind") && a > 0) return false;
    r[0] = a * b + std::sin(c);
    r[1] = std::exp(0.1 * a) * c;
    if (Is("kink")) r[1] = std::abs(c - 0.5);
    const bool is_small = std::strncmp(how_, "small", 5) == 0;
    const double unit = is_small ? 1e-12 : 1;
    r[1] *= unit;
    if (j == nullptr) return true;
    double first[4] = {b, a, 0.1 * r[1], 0};
    double second[2] = {std::cos(c), unit * std::exp(0.1 * a)};
    if (Is("small sign")) first[2] *= -1;
    if (Is("small factor")) second[1] *= 2;
    if (Is("small zero")) first[2] = 0;
    if (Is("kink")) first[2] = 0, second[1] = c > 0.5 ? 1 : -1;
    if (Is("sign")) first[1] *= -1, first[3] *= -1;
    if (Is("factor")) second[0] *= 2, second[1] *= 2;
    if (Is("degrees")) second[0] *= M_PI / 180, second[1] *= M_PI / 180;
    if (Is("zero")) first[0] = first[2] = 0;
    if (Is("not_finite")) first[0] = NAN;
    if (Is("float_precision")) first[0] *= 1 - 2e-6 * b, first[2] *= 1 + 1e-6 * b;
    if (Is("last digits")) first[1] *= 1 + 1e-6, first[0] *= 1 - 2e-6 * b;
    if (j[0] != nullptr) std::memcpy(j[0], first, sizeof(first));
    if (j[1] != nullptr) std::memcpy(j[1], second, sizeof(second));
    return true;
  }
  bool Is(const char* how) const { return std::strcmp(how, how_) == 0; }
  const char* how_;
};

int main(int argc, char** argv) {
  if (argc == 1) return Example();
  const double x[2] = {1.3, -0.7}, y[1] = {0.5};
  const ceres::QuaternionManifold quaternion;
  bundle::CheckOptions options;
  if (argc > 2) options.num_samples = std::atoi(argv[2]);
  try {
    const std::string how = argv[1];
    const Spoiled cost(argv[1]);
    if (how == "too few") bundle::CheckGradients(cost, {x});
    if (how == "manifold") bundle::CheckGradients(cost, {x, y}, {&quaternion, nullptr});
    if (how == "names") options.names = {"x"};
    const bundle::GradientCheck check = bundle::CheckGradients(cost, {x, y}, {}, options);
    std::cout << check.verdict() << "|" << check.num_checked() << "|";
    for (const auto& finding : check.findings()) std::cout << finding.kind << "=" <<
        finding.sentence << "|";
  } catch (const std::invalid_argument& error) {
    std::cout << "refused|" << error.what();
  }
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example, whose one source also has the functions above: they run if it gets arguments."""
    project = tmp_path_factory.mktemp("check") / EXAMPLE.name
    shutil.copytree(EXAMPLE, project)
    source = project / "check_jacobians.cpp"
    example = source.read_text()
    assert example.count("int main() {") == 1
    source.write_text(example.replace("int main() {", "int Example() {") + MORE)
    build(project, project / "build")
    return project / "build" / "check_jacobians"


def test_the_example_runs(program: Path) -> None:
    out = run("ctest", "--test-dir", program.parent, "--verbose", "--no-tests=error")
    words = " ".join(out.split())
    assert "100% tests passed" in words
    assert "position [1]: the sign is flipped" in words
    assert "Jet: expected 5 derivatives, one per parameter, found 4" in words
    assert "zero, although the residual depends on it" in words


def in_python(how: str, num_samples: int) -> bundle.GradientReport:
    """The same function and mistake, by the checker in Python."""

    def function(blocks):
        (a, b), (c,) = blocks
        r = np.array([a * b + np.sin(c), np.exp(0.1 * a) * c])
        first, second = (
            np.array([[b, a], [0.1 * r[1], 0]]),
            np.array([[np.cos(c)], [np.exp(0.1 * a)]]),
        )
        if how == "kink":
            r[1], first[1, 0], second[1] = abs(c - 0.5), 0, 1 if c > 0.5 else -1
        if how == "sign":
            first[:, 1] *= -1
        if how == "factor":
            second *= 2
        if how == "degrees":
            second *= np.pi / 180
        if how == "zero":
            first[:, 0] = 0
        if how == "not_finite":
            first[0, 0] = np.nan
        if how == "float_precision":
            first[:, 0] *= [1 - 2e-6 * b, 1 + 1e-6 * b]
        if how == "last digits":  # two columns, of which one has a constant factor
            first[0] *= [1 - 2e-6 * b, 1 + 1e-6]
        return r, [first, second]

    return bundle.check_gradients(function, [[1.3, -0.7], [0.5]], num_samples=num_samples)


WRONG = ("sign", "factor", "degrees", "zero", "not_finite", "float_precision", "last digits")


@pytest.mark.parametrize("how", ["right", *WRONG])
def test_verdicts_and_words_are_those_of_python(program: Path, how: str) -> None:
    verdict, count, *found = run(program, how).rstrip("|").split("|")
    report = in_python(how, 10)
    assert (verdict, int(count)) == (report.verdict, report.num_checked)
    kinds = {finding.kind: finding.sentence for finding in report.findings}
    assert dict(entry.split("=", 1) for entry in found) == kinds


@pytest.mark.parametrize("how", ["right", "sign", "factor", "zero"])
def test_a_row_of_small_numbers_hides_nothing(program: Path, how: str) -> None:
    verdict = run(program, f"small {how}").split("|")[0]
    assert verdict == ("correct" if how == "right" else "wrong")


def test_undecided_and_skipped_points(program: Path) -> None:
    assert run(program, "kink", "1").startswith("undecided|1|")
    assert run(program, "behind").startswith("undecided|0|")


@pytest.mark.parametrize(
    ("how", "line"),
    [
        ("too few", "parameters: expected 2, one per parameter block, found 1"),
        ("manifold", "manifolds: expected one of 2 parameters for block 0, found 4"),
        ("names", "names: expected 2, one per parameter block, found 1"),
    ],
)
def test_bad_arguments_are_one_line(program: Path, how: str, line: str) -> None:
    assert run(program, how) == f"refused|{line}"


HEADERS = ["check.h", "entry_scales.h", "jet_cost.h", "numeric_jacobian.h"]
HEADERS += ["resolution.h", "richardson.h"]


@pytest.mark.parametrize(
    ("compiler", "headers"),
    [*(("g++", [header]) for header in HEADERS), ("clang++", HEADERS)],
    ids=[*HEADERS, "clang++"],
)
def test_compilers_accept_the_headers(compiler: str, headers: list[str], tmp_path: Path) -> None:
    """Each alone; with the installed Ceres, and with those of BUNDLE_OTHER_CERES, a path."""
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    (tmp_path / "x.cpp").write_text("".join(f"#include <bundle/{name}>\n" for name in headers))
    others = [path for path in os.environ.get("BUNDLE_OTHER_CERES", "").split(os.pathsep) if path]
    for folder in ([], *([path] for path in others)):
        include = [word for path in (*folder, "/usr/include/eigen3") for word in ("-isystem", path)]
        done = subprocess.run(
            [compiler, "-std=c++17", "-fsyntax-only", *WARNINGS.split(),
             f"-I{bundle.get_include()}", *include, tmp_path / "x.cpp"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
