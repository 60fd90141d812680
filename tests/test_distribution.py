"""Metadata of the installed distribution, and of a wheel with libraries."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.licenses import canonicalize_license_expression
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tools"))
import wheel_licences  # noqa: E402

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_distribution_is_not_named_like_the_one_of_others_on_pypi() -> None:
    assert PROJECT["name"] == "bundle-adjust"
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "python").rglob("*.py")]
    wrong = ("pip install bundle\n", "pip install bundle[", "pip install bundle ")
    assert not [page for page in pages if any(text in page.read_text() for text in wrong)]


def test_own_licence_files_are_there_and_match_the_expression() -> None:
    texts = [(ROOT / name).read_text() for name in PROJECT["license-files"]]
    assert PROJECT["license"] == wheel_licences.OWN == "BSD-3-Clause AND MIT"
    assert "BSD 3-Clause" in texts[0]
    assert "MIT License" in texts[1]


LIBRARIES = [*wheel_licences.BUILT, *wheel_licences.SYSTEM]


def test_expression_is_spdx_names_each_term_once_and_no_plain_gpl() -> None:
    expression = wheel_licences.expression(LIBRARIES)
    assert canonicalize_license_expression(expression) == expression
    terms = expression.split(" AND ")
    assert len(terms) == len(set(terms))
    assert {"LGPL-2.1-or-later", "MPL-2.0", "Apache-2.0", "bzip2-1.0.6"} <= set(terms)
    gpl = [term for term in terms if term.startswith("GPL")]
    assert gpl == ["GPL-3.0-or-later WITH GCC-exception-3.1"]
    without = wheel_licences.expression(["libcholmod"]).split(" AND ")
    assert set(terms) - set(without) == {*gpl, "bzip2-1.0.6"}


def test_a_library_of_unknown_licence_ends_it() -> None:
    with pytest.raises(SystemExit, match="libspqr"):
        wheel_licences.expression(["libcholmod", "libspqr"])


def filled(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    return folder


BUILT = ["ceres.txt", "eigen-MPL-2.0.txt", "glog.txt", "rapidjson.txt", "suitesparse-CHOLMOD.txt"]


def test_texts_come_from_what_was_built_and_from_either_system(tmp_path: Path) -> None:
    built = filled(tmp_path / "built", *BUILT)
    debian = filled(
        tmp_path / "debian", "doc/libgfortran5/copyright", "common-licenses/GPL-3", "doc/other"
    )
    files = wheel_licences.licence_files(["libcholmod", "libgfortran"], built, debian)
    assert sorted(files) == sorted([*BUILT, "pybind11.txt", "libgfortran.txt", "GPL-3.0.txt"])
    assert "Wenzel Jakob" in files["pybind11.txt"].read_text()
    assert files["libgfortran.txt"] == debian / "doc/libgfortran5/copyright"
    alma = filled(tmp_path / "alma", "licenses/bzip2-libs/LICENSE")
    files = wheel_licences.licence_files(["libcholmod", "libbz2"], built, alma)
    assert sorted(files) == sorted([*BUILT, "pybind11.txt", "libbz2.txt"])
    assert files["libbz2.txt"] == alma / "licenses/bzip2-libs/LICENSE"


def test_a_text_that_is_not_there_ends_it(tmp_path: Path) -> None:
    built = filled(tmp_path / "built", *BUILT)
    with pytest.raises(SystemExit, match="bzip2-libs"):
        wheel_licences.licence_files(["libbz2"], built, tmp_path)
    with pytest.raises(SystemExit, match="nobody-has-this"):
        wheel_licences.installed_text("nobody-has-this")
    (built / "glog.txt").unlink()
    with pytest.raises(SystemExit, match="glog"):
        wheel_licences.licence_files(["libcholmod"], built, tmp_path)


def test_metadata_gets_the_expression_and_the_files() -> None:
    before = "Name: x\nLicense-Expression: MIT\nLicense-File: LICENSE\n"
    after = wheel_licences.rewrite_metadata(before, "MIT AND MPL-2.0", ["a.txt", "b/c.txt"])
    assert after == (
        "Name: x\nLicense-Expression: MIT AND MPL-2.0\nLicense-File: a.txt\n"
        "License-File: b/c.txt\nLicense-File: LICENSE\n"
    )


def test_scripts_that_cibuildwheel_runs_are_there_and_runnable() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["cibuildwheel"]
    commands = [settings["test-command"], *settings["linux"]["before-all"]]
    commands += settings["linux"]["repair-wheel-command"]
    scripts = set(re.findall(r"tools/\w+\.\w+", " ".join(commands)))
    assert len(scripts) == 3
    for script in scripts:
        assert (ROOT / script).is_file()
        if script.endswith(".sh"):
            subprocess.run(["bash", "-n", ROOT / script], check=True)
    # Both ways of building a wheel are made of the same parts.
    alone = (ROOT / "tools/build_wheel.sh").read_text()
    assert all(script in alone for script in scripts)


def test_the_trial_of_a_wheel_passes_on_this_installation() -> None:
    script, folder = ROOT / "tools/try_wheel.sh", Path(sys.executable).parent
    done = subprocess.run(["bash", script, folder, ROOT / "data"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == "tried: all well"


def requirement(name: str) -> Requirement:
    found = [Requirement(text) for text in PROJECT["dependencies"]]
    return next(one for one in found if one.name == name)


@pytest.mark.parametrize(
    ("system", "machine", "required"),
    [
        ("Linux", "x86_64", True),
        ("Linux", "aarch64", False),
        ("Darwin", "arm64", True),
        ("Darwin", "x86_64", False),
        ("Windows", "AMD64", True),
        ("Windows", "ARM64", False),
    ],
)
def test_pycolmap_is_required_where_its_wheels_exist(
    system: str, machine: str, required: bool
) -> None:
    marker = requirement("pycolmap").marker
    assert marker is not None
    assert marker.evaluate({"platform_system": system, "platform_machine": machine}) is required
    assert PROJECT["optional-dependencies"]["pycolmap"] == ["pycolmap>=4.0"]


def test_metadata_names_authors_and_every_python_and_no_url() -> None:
    assert PROJECT["authors"] == [{"name": "the bundle authors"}]
    assert "urls" not in PROJECT
    text = (ROOT / "pyproject.toml").read_text()
    for minor in (11, 12, 13, 14):
        assert f"Programming Language :: Python :: 3.{minor}" in PROJECT["classifiers"]
        assert f"cp3{minor}-manylinux_*" in text
    assert not [c for c in PROJECT["classifiers"] if c.startswith("License")]


def test_citation_agrees_with_the_project() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == PROJECT["version"]
    assert citation["authors"] == PROJECT["authors"]
    assert " AND ".join(citation["license"]) == PROJECT["license"]


def test_recipe_of_conda_lists_the_dependencies_of_the_project() -> None:
    text = (ROOT / "packaging" / "conda" / "meta.yaml").read_text()
    text = re.sub(r"^\{%.*%\}$", "", text, flags=re.MULTILINE)
    recipe = yaml.safe_load(re.sub(r"\{\{.*?\}\}", "x", text))
    run = {entry.split()[0] for entry in recipe["requirements"]["run"]} - {"python"}
    constrained = {entry.split()[0] for entry in recipe["requirements"]["run_constrained"]}
    assert run | constrained == {Requirement(text).name for text in PROJECT["dependencies"]}
    assert f'"{PROJECT["version"]}"' in (ROOT / "packaging" / "conda" / "meta.yaml").read_text()


def test_hooks_run_the_tools_of_the_project() -> None:
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    tools = {hook["entry"].split()[0] for hook in hooks}
    names = {Requirement(text).name for text in PROJECT["optional-dependencies"]["lint"]}
    assert {f".venv/bin/{name}" for name in names} <= tools


def test_image_installs_extras_of_the_project() -> None:
    text = (ROOT / "packaging" / "Dockerfile").read_text()
    extras = re.search(r"/source\[([\w,]+)\]", text)
    assert extras is not None
    assert set(extras[1].split(",")) <= set(PROJECT["optional-dependencies"])
