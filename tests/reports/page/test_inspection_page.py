"""The page of a problem: every method, every order, and images that can be stepped through."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re

import numpy as np
import pytest

from bundle import SolveOptions
from bundle.planning.inspection.inspection_result import Inspection, MethodInspection
from bundle.planning.inspection.rank_prediction import find_rank_limit
from bundle.reports.page.elimination_player import best_connected, image_graph, spread
from bundle.reports.page.inspection_page import write_inspection
from tests.planning.inspection.test_rank_limit import row
from tests.reports.page.browser import check_nothing_is_clipped
from tests.reports.page.reader import Page, check_self_contained
from tests.scenes import make_problem

NUMBERS = {
    field.name: 0
    for field in dataclasses.fields(MethodInspection)
    if field.name.startswith(("nnz", "num", "flops", "cholmod", "fill", "tree"))
}
NOTE = "for comparison: neither backend takes this order"


def method(name, backend, **changes):
    solver, _, rest = name.partition(" ")
    iterative = solver == "ITERATIVE_SCHUR"
    return MethodInspection(
        **{
            **NUMBERS,
            "name": name,
            "linear_solver_type": solver,
            "backend": backend,
            "ordering": "" if iterative else rest,
            "preconditioner": rest.upper() if iterative else "",
            "column_count_profile": (),
            "memory_in_bytes": 2.5e8,
            "memory_terms": (),
            "time_per_step_in_seconds": 0.125,
            "time_terms": (),
            "fits_in_memory": True,
            "is_taken": True,
            "note": "",
            **changes,
        }
    )


METHODS = (
    method("DENSE_SCHUR natural", "CERES", nnz_factor=123_456_789, flops=7.4e13,
           memory_in_bytes=6e11, fits_in_memory=False, column_count_profile=(9, 5, 0)),
    method("SPARSE_SCHUR amd", "FUSED", nnz_factor=4321, flops=1.2e8, nnz_reduced=987,
           column_count_profile=(3, 2, 1, 0)),
    method("SPARSE_SCHUR colamd", "", nnz_factor=4400, flops=1.3e8, note=NOTE),
    method("SPARSE_SCHUR nesdis", "", nnz_factor=4500, flops=1.4e8, note=NOTE),
    method("ITERATIVE_SCHUR jacobi", "FUSED"),
)  # fmt: skip
INSPECTION = Inspection(
    num_observations=120,
    num_free_points=40,
    num_camera_columns=90,
    num_camera_blocks=10,
    reduced_density=0.75,
    num_threads=2,
    available_memory_in_bytes=2.4e10,
    methods=METHODS,
    recommended=1,
    recommendation="SPARSE_SCHUR: S is 75 % full <b>.",
    auto_choice="SPARSE_SCHUR",
)


def images(count, **changes):
    return make_problem(num_images=count, num_points=40, track=3, seed=count, **changes)


@pytest.fixture
def written(tmp_path):
    def write(problem=None, options=None, inspection=INSPECTION, **more):
        path = tmp_path / "inspection.html"
        write_inspection(inspection, path, problem, options, name="<a street>", **more)
        page = Page(path)
        check_self_contained(page)
        return path, page

    return write


LABELS = {
    "ceres DENSE_SCHUR natural", "fused SPARSE_SCHUR amd", "SPARSE_SCHUR colamd",
    "SPARSE_SCHUR nesdis", "fused ITERATIVE_SCHUR jacobi",
}  # fmt: skip


def test_every_method_is_a_row_and_so_is_every_factor(written):
    _, page = written()
    rows = {row[0]: row[1:] for row in page.rows if row[0] in LABELS and len(row) == 5}
    assert next(iter(rows)) == "fused SPARSE_SCHUR amd"  # what is recommended
    assert list(rows)[-1] == "ceres DENSE_SCHUR natural"  # what does not fit
    assert set(rows) == LABELS
    assert rows["fused SPARSE_SCHUR amd"][:3] == ["125 ms", "250 MB", "yes"]
    assert rows["ceres DENSE_SCHUR natural"][1:3] == ["600 GB", "NO"]
    factors = {row[0]: row[1:] for row in page.rows if row and len(row) == 8}
    assert factors["SPARSE_SCHUR amd"][:4] == ["987", "4321", "0", "1.200e+08"]
    assert factors["DENSE_SCHUR natural"][:2] == ["-", "1.235e+08"]
    assert "ITERATIVE_SCHUR jacobi" not in factors


def test_the_page_leads_with_what_to_take_how_and_why(written):
    _, page = written()
    title, headline, *words = filter(str.strip, page.words)
    words = words[page.source.count("<li><a ") :]  # after the contents
    assert "<a street>" in title
    for part in ("fused SPARSE_SCHUR amd", "125 ms", "250 MB"):
        assert part in headline
    command = "bundle refine '<a street>' -o OUTPUT --solver sparse-schur"
    told = " ".join(words)
    assert told.startswith(f"{command} {INSPECTION.recommendation}")
    _, page = written(inspection=dataclasses.replace(INSPECTION, recommended=-1))
    assert "24 GB" in page.text
    assert "bundle refine" not in page.text


def test_several_processes(written):
    """Where they stop to pay stands above the table, whose row of the most that do stands out."""
    ranks = [row(n, points=10.0, first=1.0, messages=0.001 * (n > 1)) for n in (1, 4, 16)]
    _, page = written(ranks=ranks, network=(25.0, 5.0))
    rows = {cells[0]: cells[1:] for cells in page.rows if len(cells) == 7}
    assert rows["1"] == ["11 s", "-", "100 %", "-", "1 GB", "-"]
    assert rows["16"] == ["1.63 s", "1 ms", "42 %", "8 MB", "1 GB", "500 MB"]
    assert find_rank_limit(ranks).message in page.text
    assert "25 Gbit/s and 5 microseconds" in page.text
    best = page.source.split('<tr class="best">')[-1]
    assert best.startswith('<th scope="row" data-label="processes">4</th>')
    memory = page.source.split("Peak memory")[-1].split("</figure>")[0]
    assert ">GB<" in memory
    assert re.findall(r">([\d.]+)<", memory)[-2:] == ["0.1", "1"]  # ticks of 0.5 to 1 GB
    assert "the first process alone" in page.text  # its line in the chart
    _, without = written()
    assert "Several processes" not in without.text


def test_options_are_in_the_command(written):
    _, page = written(options=SolveOptions(refine=("poses", "points"), num_threads=1))
    assert "--solver sparse-schur --threads 1 --refine poses,points" in page.text


def test_rows_beyond_five_are_folded_away(written):
    many = tuple(
        method(f"SPARSE_SCHUR order{i}", "FUSED", nnz_factor=1, flops=10.0**i,
               time_per_step_in_seconds=0.1 * (9 - i))
        for i in range(9)
    )  # fmt: skip
    _, page = written(inspection=dataclasses.replace(INSPECTION, methods=many, recommended=8))
    shown, folded = page.source.replace("<wbr>", "").split("<details", 1)
    names = [f"fused SPARSE_SCHUR order{i}" for i in reversed(range(9))]
    assert [name for name in names if name in shown] == names[:5]
    assert [name for name in names if f">{name}</th>" in folded] == names[5:]
    assert page.words.count("4 more") == 4  # methods, factors, and bars of both
    _, page = written(inspection=dataclasses.replace(INSPECTION, methods=many[:6], recommended=5))
    assert "<details" not in page.source  # a single one is not worth it


@pytest.mark.parametrize("width", [1300, 800, 400])
def test_nothing_is_clipped(written, browser, width):
    long = method("ITERATIVE_SCHUR schur_power_series_expansion", "FUSED", note=NOTE)
    methods = dataclasses.replace(INSPECTION, methods=(*METHODS, long, long, long))
    ranks = [row(n, points=10.0, first=1.0, messages=0.001 * (n > 1)) for n in (1, 16, 256)]
    path, _ = written(images(40), inspection=methods, ranks=ranks)
    check_nothing_is_clipped(browser, path, width)


def test_notes_stand_once_and_rows_point_to_them(written):
    _, page = written()
    assert page.text.count(NOTE) == 1
    pointing = [row[0] for row in page.rows if len(row) == 5 and row[-1] == "1"]
    assert pointing == ["SPARSE_SCHUR colamd", "SPARSE_SCHUR nesdis"]
    assert "Does not fit in memory: ceres DENSE_SCHUR natural." in page.text


def test_convention_stands_with_the_numbers(written):
    _, page = written()
    assert "matrices count both triangles and the diagonal, L its lower triangle" in page.text
    assert INSPECTION.recommendation in page.text
    assert all(address.startswith("#") for address in page.loads) and not page.scripts


def test_matrices_are_drawn_under_every_order_with_their_nonzeros(written):
    problem = images(12)
    _, page = written(problem, SolveOptions(gauge="none"))
    captions = [word for word in page.words if "nonzeros (" in word]
    orders = ("natural", "amd", "colamd", "metis", "nesdis", "minimum_fill")
    assert [caption.partition(":")[0] for caption in captions] == [
        *(f"{name}, {order}" for order in orders for name in "SL"),
        "information matrix, points first",
    ]
    assert sum(address.startswith("data:") for address in page.loads) == 13
    seen = [set() for _ in range(12)]
    for image, point in zip(problem.observation_image, problem.observation_point, strict=True):
        seen[image].add(int(point))
    pairs = sum(bool(a & b) for a, b in itertools.combinations(seen, 2))
    size = {int(caption.split(": ")[1].split()[0].replace(",", "")) for caption in captions[0:12:2]}
    block = 6 + 2  # SIMPLE_RADIAL: focal length and k1; the principal point stays
    assert size == {block**2 * (12 + 2 * pairs)}


@pytest.mark.parametrize(("density", "orders"), [(1.0, 1), (0.95, 1), (0.94, 6)])
def test_a_full_matrix_is_drawn_once(written, density, orders):
    full = dataclasses.replace(INSPECTION, reduced_density=density)
    _, page = written(images(12), inspection=full)
    assert sum("nonzeros (" in word for word in page.words) == 2 * orders + 1


def test_options_decide_what_is_drawn(written):
    problem = images(12)
    _, every = written(problem)
    _, some = written(problem, SolveOptions(refine=("poses", "points")))
    assert every.source != some.source


def test_images_are_stepped_through_under_their_names(written, browser):
    hostile = "</script><b>.jpg"
    path, page = written(images(40, image_names=[f"{hostile}{i}" for i in range(40)]))
    data = json.loads(page.scripts[0])["elimination"]
    assert 3 <= len(data["names"]) <= 24
    assert {run["ordering"] for run in data["runs"]} == {"natural", "minimum degree"}
    browser.open(path)
    browser.press("End")
    count = len(data["names"])
    assert browser.text("#where") == f"{count} of {count}"
    assert browser.count("#graph .fill.shown") == data["runs"][0]["fill"]
    assert browser.complaints() == []


@pytest.mark.parametrize("count", [1, 2])
def test_hardly_a_problem_is_a_page_too(written, count):
    written(make_problem(num_images=count, num_points=5))


def test_images_of_a_route_are_taken_in_even_steps():
    """Each meets the ten before it: taken every fifth, each meets two before it."""
    count = 200
    low, high = np.array([(a, b) for b in range(count) for a in range(max(b - 10, 0), b)]).T
    chosen = spread(low, high, count, 24)
    assert len(chosen) == 24
    assert set(np.diff(chosen)) == {4}


def test_images_that_share_nothing_are_no_graph():
    nothing = np.empty(0, np.int64)
    assert len(spread(nothing, nothing, 100, 24)) == 0
    assert len(best_connected(nothing, nothing, nothing, 24)) == 0


def test_best_connected_grow_from_the_heaviest_edge():
    low, high = np.array([0, 1, 2, 3, 5]), np.array([1, 2, 3, 4, 6])
    weights = np.array([1, 9, 10, 2, 8])
    assert best_connected(low, high, weights, 3).tolist() == [2, 3, 1]
    # 5 and 6 have no way there.
    assert set(best_connected(low, high, weights, 9).tolist()) == {0, 1, 2, 3, 4}


def test_edges_of_images_are_points_in_common():
    problem = images(9)
    names, edges = image_graph(problem, most=9)
    assert len(names) == 9
    seen = [set(problem.observation_point[problem.observation_image == i]) for i in range(9)]
    assert set(edges) == {
        (a, b) for a, b in itertools.combinations(range(9), 2) if seen[a] & seen[b]
    }


def test_the_recommended_one_leads_even_if_another_claims_to_be_faster(written):
    one = method("SPARSE_SCHUR amd", "FUSED", time_per_step_in_seconds=0.2)
    faster = method("DENSE_SCHUR natural", "FUSED", time_per_step_in_seconds=0.1)
    _, page = written(inspection=dataclasses.replace(INSPECTION, methods=(faster, one)))
    rows = [row[0] for row in page.rows if row[0] in ("fused " + one.name, "fused " + faster.name)]
    assert rows == ["fused " + one.name, "fused " + faster.name]


def test_backend_and_preconditioner_are_in_the_command(written):
    best = method("ITERATIVE_SCHUR cluster_jacobi", "CERES")
    _, page = written(inspection=dataclasses.replace(INSPECTION, methods=(best,), recommended=0))
    for words in ("--solver iterative-schur", "--preconditioner cluster-jacobi", "--backend ceres"):
        assert words in page.text
