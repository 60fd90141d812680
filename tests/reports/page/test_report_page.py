"""The report page: what it draws is what it holds, in a browser, in both themes."""

from __future__ import annotations

import base64
import json
import re

import numpy as np
import pytest
from PIL import Image

import bundle
from bundle import InputError
from bundle.figures.residual_field import residual_fields
from bundle.model.residuals import residuals
from bundle.reports.page.page import photograph
from bundle.reports.page.report_page import write_report
from tests.figures.matplotlib.test_placement_numbers import RECORD, covariances
from tests.reports.page.browser import check_nothing_is_clipped
from tests.reports.page.reader import Page
from tests.scenes import make_problem, scene


@pytest.fixture(scope="module")
def solved():
    problem = make_problem(num_images=8, num_points=300, shared=True, seed=4)
    return bundle.solve(problem, max_num_iterations=5)


def data_of(page):
    return json.loads(page.scripts[0])


@pytest.fixture
def written(solved, tmp_path):
    path = tmp_path / "report.html"
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    first, second = (image.name for image in solved.worst_images[:2])
    exif = Image.Exif()
    exif[0x8769] = {0x9003: "2021:05:01 10:03:20"}
    Image.new("RGB", (400, 300), (90, 120, 150)).save(photographs / first, "JPEG", exif=exif)
    exif[0x8769] = {0x9003: "2021:05:01 10:41:00"}
    other = Image.new("RGB", (300, 400))  # of another shape
    other.save(photographs / second, "JPEG", exif=exif)
    notes = write_report(solved, path, images=photographs, name="<b>scene")
    return path, Page(path), notes


def test_the_page_says_what_went_in_and_came_out(written, solved):
    _, page, _ = written
    rows = {row[0]: row[1:] for row in page.rows if len(row) == 3}
    before, after = solved.reprojection_error_before, solved.reprojection_error_after
    assert rows["RMSE [px]"] == [f"{before.rmse:.4f}", f"{after.rmse:.4f}"]
    assert float(rows["cost"][1]) == pytest.approx(solved.summary.final_cost, rel=1e-8)
    assert rows["observations"] == ["2400", "2400"]
    assert rows["images"] == ["8", "8"] and rows["points"] == ["300", "300"]
    assert "<b>scene" in page.text
    assert "8 images, 1 camera, 300 points" in page.text
    assert "Captured 2021-05-01 10:03 to 2021-05-01 10:41." in page.text
    for words in solved.summary.warnings:
        assert words in page.text


def test_the_page_loads_nothing_and_leads_to_its_sections(written):
    _, page, _ = written
    inside = [address for address in page.loads if address.startswith("#")]
    assert {address[1:] for address in inside} <= set(page.ids)
    assert len(inside) == 7
    others = set(page.loads) - set(inside)
    assert all(address.startswith("data:image/") for address in others)
    rest = re.sub(r"http://www\.w3\.org/(2000/svg|1999/xhtml)", "", page.source)
    assert not re.search(r"https?:|@import|url\(", rest)
    assert "default-src &#x27;none&#x27;" in page.source
    assert len(page.ids) == len(set(page.ids))


def test_photographs_are_shown_and_missed(written):
    _, page, notes = written
    assert page.source.count("data:image/jpeg;base64,") == 1
    missing, misfit = notes
    assert "No photograph" in missing and "300 x 400" in misfit
    for words in notes:
        assert words in page.text


def test_photographs_outside_of_the_folder_and_broken_ones_are_none(tmp_path):
    folder = tmp_path / "photographs"
    folder.mkdir()
    Image.new("RGB", (40, 30)).save(tmp_path / "outside.jpg")
    Image.new("RGB", (40, 30)).save(folder / "inside.png")
    (folder / "broken.jpg").write_bytes(b"no picture")
    outside = str(tmp_path / "outside.jpg")
    for name in ("../outside.jpg", outside, "broken.jpg", "", "none.jpg"):
        assert photograph(folder, name) is None
    assert photograph(folder, "inside.png").size == (40, 30)
    assert photograph(folder, "left/inside.png").size == (40, 30)


def test_histograms_are_those_before_and_after(written, solved):
    held = data_of(written[1])["histogram"]
    for label, problem in (("before", solved.initial_problem), ("after", solved.problem)):
        values = residuals(problem).xy.ravel()
        expected = np.histogram(values, held["edges"])[0]
        np.testing.assert_allclose(held["coordinates"][label], expected, atol=1)
        sigma = 1.4826 * np.median(np.abs(values))
        assert held["sigma"][label] == pytest.approx(sigma)


def test_every_drawn_cell_is_that_of_the_numbers_of_the_page(written, solved, browser):
    path, page, _ = written
    (field,) = data_of(page)["fields"]
    (expected,) = residual_fields(solved.problem, residuals(solved.problem))
    assert field["count"] == expected.count.ravel().tolist()
    for name, values in (("mean_x", expected.mean[..., 0]), ("rms", expected.rms)):
        held = np.array([np.nan if v is None else v for v in field[name]])
        np.testing.assert_allclose(held, values.ravel(), rtol=1e-5, atol=1e-9)
    browser.open(path)
    cells = browser.evaluate(
        "[...document.querySelectorAll('.heat')].map((g) => [g.ownerSVGElement.ariaLabel,"
        " [...g.children].map((r) => [+r.dataset.cell, +r.getAttribute('fill-opacity')])])"
    )
    drawn = {name: dict(pairs) for name, pairs in cells}
    count = np.array(field["count"], float)
    mean = np.hypot(*np.array([field["mean_x"], field["mean_y"]], float))
    error = np.array([np.nan if v is None else v for v in field["standard_error"]], float)
    rms = np.array([np.nan if v is None else v for v in field["rms"]], float)
    count[count == 0] = np.nan
    significance = mean / error
    for name, values, least in (
        ("count", count, 0.0), ("magnitude", rms, 0.0), ("significance", significance, 6.06)
    ):  # fmt: skip
        known = np.isfinite(values)
        assert set(drawn[name]) == set(np.flatnonzero(known).tolist())
        top = max(np.quantile(values[known], 0.98), least)
        shares = np.array([drawn[name][k] for k in np.flatnonzero(known)])
        np.testing.assert_allclose(shares, np.minimum(values[known] / top, 1.0), atol=6e-4)
    lines = browser.evaluate(
        "[...document.querySelectorAll('.vectors path')].map((p) =>"
        " [+p.dataset.cell, p.getAttribute('d'), p.classList.contains('bold')])"
    )
    left, top, right, bottom = field["box"]
    unit = 400.0 / (right - left)
    assert {cell for cell, _, _ in lines} == set(np.flatnonzero(np.isfinite(count)).tolist())
    for cell, path_data, bold in lines:
        row, column = divmod(cell, field["columns"])
        start, step = path_data[1:].split("l")
        place = [
            2 + (column + 0.5) * 400.0 / field["columns"],
            2 + (row + 0.5) * (bottom - top) * unit / field["rows"],
        ]
        np.testing.assert_allclose([float(v) for v in start.split()], place, atol=0.006)
        vector = np.array([field["mean_x"][cell], field["mean_y"][cell]]) * field["vector_factor"]
        np.testing.assert_allclose([float(v) for v in step.split()], vector * unit, atol=0.006)
        assert bold == bool(significance[cell] > 3.03)


def test_the_page_is_quiet_and_fits_in_both_themes(written, browser):
    path, _, _ = written
    colours = []
    for theme in ("light", "dark"):
        features = [{"name": "prefers-color-scheme", "value": theme}]
        browser.call("Emulation.setEmulatedMedia", features=features)
        check_nothing_is_clipped(browser, path, 1200)
        assert browser.complaints() == []
        assert browser.requested() == [path.as_uri()]
        colours.append(browser.evaluate("getComputedStyle(document.body).backgroundColor"))
    browser.call("Emulation.setEmulatedMedia", features=[])
    check_nothing_is_clipped(browser, path, 400)
    assert colours[0] != colours[1]
    assert path.stat().st_size < 8e6


def test_the_3d_view_paints_and_its_switches_change_it(written, solved, browser):
    path, page, _ = written
    scene = data_of(page)["scene"]
    for name, state in (("before", solved.initial_problem), ("after", solved.problem)):
        points = np.frombuffer(base64.b64decode(scene[name]["points"]), "<f4").reshape(-1, 3)
        world = np.array(scene["origin"]) + scene["unit"] * points
        np.testing.assert_allclose(world, state.points, atol=1e-5)
        shades = np.frombuffer(base64.b64decode(scene[name]["error"]["shades"]), np.uint8)
        lengths = residuals(state).lengths.reshape(-1, 8)  # all 8 images see each point
        assert state.observation_point.reshape(-1, 8).std(axis=1).max() == 0
        rmse = np.sqrt((lengths**2).mean(axis=1))
        limit = float(scene[name]["error"]["ends"][1].split()[0])
        np.testing.assert_allclose(shades / 254, np.minimum(rmse / limit, 1), atol=3e-3)
    browser.open(path)
    browser.wait_for("Number(document.querySelector('.scene').dataset.drawn) > 0")
    painted = (
        "(() => { const from = document.querySelector('.scene canvas');"
        " const to = document.createElement('canvas'); to.width = from.width;"
        " to.height = from.height; const pen = to.getContext('2d'); pen.drawImage(from, 0, 0);"
        " const rgba = pen.getImageData(0, 0, to.width, to.height).data; const seen = new Map();"
        " for (let i = 0; i < rgba.length; i += 4) { const key = rgba[i] + 256 * rgba[i + 1] +"
        " 65536 * rgba[i + 2]; seen.set(key, (seen.get(key) || 0) + 1); }"
        " return [seen.size, rgba.length / 4 - Math.max(...seen.values())]; })()"
    )

    def next_frame() -> list[int]:
        frames = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
        browser.call("Runtime.evaluate", expression=frames, awaitPromise=True)
        return browser.evaluate(painted)

    colours, everything = next_frame()
    assert colours > 10 and everything > 300
    browser.click("[data-state=before]")
    assert browser.evaluate("document.querySelector('[data-state=after]').ariaPressed") == "false"
    assert next_frame() != [colours, everything]
    browser.click("[data-state=after]")
    assert next_frame() == [colours, everything]
    browser.click("[data-shows=points]")
    _, others = next_frame()
    browser.click("[data-shows=ellipsoids]")
    _, cameras = next_frame()
    browser.click("[data-shows=cameras]")
    assert 0 < cameras < others < everything
    assert next_frame()[1] == 0
    assert browser.complaints() == []


def test_sigmas_are_those_of_the_library(written, solved):
    _, page, _ = written
    cov = bundle.covariance(solved, scale="sigma0")
    sigmas = {row[2]: row[-1] for row in page.rows if len(row) == 6 and row[0] == "1"}
    expected = np.sqrt(np.diag(cov.camera(1)))
    assert float(sigmas["f"]) == pytest.approx(expected[0], rel=1e-3)
    assert float(sigmas["k"]) == pytest.approx(expected[3], rel=1e-3)
    (lens,) = data_of(page)["lenses"]
    assert max(lens["sigma"]) > 0
    assert "inner" in page.text
    rotations = next(row for row in page.rows if "rotation of a camera" in row[0])
    worst = [np.linalg.eigvalsh(block[:3, :3])[-1] for block in cov.pose_covariance]
    assert float(rotations[2]) == pytest.approx(np.degrees(np.sqrt(np.median(worst))), rel=1e-2)


def test_placement_and_certainty_are_on_the_page_where_they_are_known(solved, tmp_path, browser):
    problem = solved.problem
    given = covariances(problem, np.random.default_rng(2))
    path = tmp_path / "report.html"
    write_report(solved, path, georeference=RECORD, covariance=given)
    page = Page(path)
    rows = {row[0]: row[1:] for row in reversed(page.rows) if row}  # of the first table
    assert rows["control points"][0] == "2"
    assert rows["c"][0] == "suspect"
    assert rows["c"][2:5] == ["1.0000", "2.0000", "2.0000"]
    sigmas = {row[2]: row[-1] for row in page.rows if len(row) == 6 and row[0] == "1"}
    assert sigmas == {"f": "2", "cx": "held", "cy": "held", "k": "0.001"}
    assert ["f", "+1.000", "+0.500"] in page.rows
    scene = data_of(page)["scene"]
    for kind, covariance in (("point", given.point_covariance), ("camera", None)):
        ellipsoids = scene[f"{kind}_ellipsoids"]
        axes = np.frombuffer(base64.b64decode(ellipsoids["axes"]), "<f4").reshape(-1, 3, 3)
        assert f"x{ellipsoids['factor']:g} (" in page.text
        if covariance is not None:
            shape = np.swapaxes(axes, 1, 2) @ axes / ellipsoids["factor"] ** 2
            np.testing.assert_allclose(shape * scene["unit"] ** 2, covariance, rtol=1e-3, atol=1e-9)
    for theme in ("light", "dark"):
        features = [{"name": "prefers-color-scheme", "value": theme}]
        browser.call("Emulation.setEmulatedMedia", features=features)
        check_nothing_is_clipped(browser, path, 1000)
    browser.call("Emulation.setEmulatedMedia", features=[])
    assert browser.complaints() == []
    assert browser.count("[data-shows=ellipsoids]") == 1
    # Nine columns stay a table at 800 px; narrower, cells are listed and a bare id has its name.
    looks = {800: ["table-row", "none"], 400: ["block", '"camera "']}
    for width, look in looks.items():
        check_nothing_is_clipped(browser, path, width)
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.call("Emulation.setDeviceMetricsOverride", **size)
        found = browser.evaluate(LOOK)
        browser.call("Emulation.clearDeviceMetricsOverride")
        assert found == look


LOOK = """(() => {
  const row = [...document.querySelectorAll("tr")].find((r) => r.cells.length === 9);
  const id = document.querySelector("tbody th[data-label=camera]");
  return [getComputedStyle(row).display, getComputedStyle(id, "::before").content];
})()"""


def nothing_observed():
    problem = make_problem(num_images=3, num_points=10)
    return problem.replace(
        observation_image=np.zeros(0, int), observation_point=np.zeros(0, int),
        observation_xy=np.zeros((0, 2)), observation_keypoint=np.zeros(0, int),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("problem", "num_notes"),
    [
        (nothing_observed(), 2),
        (make_problem(num_images=1, num_points=5), 1),
        (make_problem(num_images=2, num_points=1), 1),
        (scene(), 0),  # no sizes, no names
    ],
    ids=["nothing", "one image", "one point", "bal"],
)
def test_hardly_a_problem_is_a_page_too(problem, num_notes, tmp_path):
    path = tmp_path / "report.html"
    notes = write_report(problem, path)
    page = Page(path)
    assert len(notes) == num_notes
    assert all(words in page.text for words in notes)
    assert "Co-visibility" in page.text


def test_everything_fixed_is_a_page_too(tmp_path):
    solved = bundle.solve(make_problem(num_images=2, num_points=8), refine=())
    write_report(solved, tmp_path / "report.html")
    rows = [row for row in Page(tmp_path / "report.html").rows if row and row[0] == "cost"]
    assert rows[0][1] == rows[0][2]


def test_bad_arguments_write_nothing(solved, tmp_path):
    for arguments in ({"images": tmp_path / "none"}, {"name": 3}):
        with pytest.raises(InputError):
            write_report(solved, tmp_path / "report.html", **arguments)
    assert list(tmp_path.iterdir()) == []


def test_reports_of_commands_do_not_hide_the_function(solved, tmp_path):
    import bundle.cli.models

    bundle.report(solved, tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size > 10_000


def test_an_image_opens_with_its_residuals_and_its_photograph(written, solved, browser):
    path, page, _ = written
    images = data_of(page)["images"]
    errors = {image.image_id: image for image in solved.worst_images}
    worst = images[0]
    assert worst["rmse"] == pytest.approx(errors[worst["id"]].rmse)
    found = residuals(solved.problem)
    rows = np.flatnonzero(solved.problem.image_ids[solved.problem.observation_image] == worst["id"])
    rows = rows[np.argsort(-found.lengths[rows])][: len(worst["vectors"]) // 4]
    expected = np.column_stack([solved.problem.observation_xy[rows], found.xy[rows]])
    np.testing.assert_allclose(np.reshape(worst["vectors"], (-1, 4)), expected, atol=6e-3)
    browser.open(path)
    browser.evaluate(
        "(() => { const chooser = document.getElementById('image'); chooser.value = '0';"
        " chooser.dispatchEvent(new Event('change')); })()"
    )
    shown = "document.querySelector('dialog[open] svg')"
    assert worst["name"] in browser.text("#image-name")
    assert browser.evaluate(f"{shown}.querySelector('image').href.baseVal").startswith("data:image")
    path_data = browser.evaluate(f"{shown}.querySelector('.residuals').getAttribute('d')")
    assert path_data.count("M") == len(rows)
    browser.click("[data-step='1']")
    assert images[1]["name"] in browser.text("#image-name")
    assert browser.evaluate(f"{shown}.querySelector('image')") is None
    browser.click("#close")
    assert browser.evaluate(shown) is None
    assert browser.complaints() == []


def test_a_click_on_a_camera_opens_its_image(written, browser):
    path, _, _ = written
    browser.open(path)
    browser.wait_for("Number(document.querySelector('.scene').dataset.drawn) > 0")
    # Look for a camera along a grid, as a user with a mouse does.
    hit = browser.evaluate(
        "(() => { const canvas = document.querySelector('.scene canvas');"
        " const box = canvas.getBoundingClientRect();"
        " for (let x = 4; x < box.width; x += 8) for (let y = 4; y < box.height; y += 8) {"
        "  const at = {clientX: box.left + x, clientY: box.top + y, bubbles: true, pointerId: 1};"
        "  canvas.dispatchEvent(new PointerEvent('pointermove', at));"
        "  const name = document.getElementById('hover').textContent;"
        "  if (!name) continue;"
        "  canvas.dispatchEvent(new PointerEvent('pointerup', {...at, clientX: 0}));"
        "  const far = document.querySelector('dialog').open;"
        "  canvas.dispatchEvent(new PointerEvent('pointerdown', at));"
        "  canvas.dispatchEvent(new PointerEvent('pointerup', at));"
        "  return [name, far, document.getElementById('image-name').textContent]; }"
        " return null; })()"
    )
    assert hit is not None
    name, dragged, shown = hit
    assert not dragged and shown.startswith(name)


def test_lenses_of_one_kind_are_one_figure(tmp_path):
    problem = make_problem(num_images=9, num_points=200, seed=2)
    sizes = problem.camera_sizes.copy()
    sizes[8] = (700, 600)
    solved = bundle.solve(problem.replace(camera_sizes=sizes))
    write_report(solved, tmp_path / "report.html")
    page = Page(tmp_path / "report.html")
    lenses = page.source.split("<h2")
    (section,) = [part for part in lenses if 'id="lenses"' in part[:20]]
    curves = section.count('data-figure="distortion"')
    focal = section.split('data-figure="focal_lengths"')
    assert (curves, len(focal)) == (2, 2)  # eight of one size, and one
    assert "8 cameras, SIMPLE_RADIAL, 800 x 600" in section
    assert section.count('class="curve faint"') == 8
    assert focal[1].split("</figure>")[0].count("<circle") == 8
    sigma = np.sqrt([solved_sigma(solved, camera) for camera in range(1, 9)])
    assert f"median sigma {np.median(sigma):.3g}"[:-1] in focal[1]


def solved_sigma(solved, camera):
    return bundle.covariance(solved, scale="sigma0").camera(camera)[0, 0]


def test_128_images_fit_on_six_screens(tmp_path, browser):
    problem = make_problem(num_images=128, num_points=1500, track=6, seed=5)
    path = tmp_path / "report.html"
    write_report(bundle.solve(problem, max_num_iterations=10), path)
    assert path.stat().st_size < 8e6
    size = {"width": 1400, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", **size)
    try:
        browser.open(path)
        assert browser.evaluate("document.documentElement.scrollHeight") <= 6 * 900
        top = "document.querySelector({!r}).getBoundingClientRect()"
        assert browser.evaluate(f"{top.format('.verdicts')}.bottom") < 900
        assert browser.evaluate(f"{top.format('.scene')}.bottom") < 900
    finally:
        browser.call("Emulation.clearDeviceMetricsOverride")
    assert browser.complaints() == []
