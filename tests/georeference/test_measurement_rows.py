"""A measurement is a row: a toy kind in flags, help, solve, JSON, schema, terminal and page.

The toy measures heights: the third coordinate z of the centre of an image is h with a standard
deviation s, so that it costs 1/2 ((z - h) / s)^2.
"""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import bundle
from bundle.base.display import Display
from bundle.errors import InputError
from bundle.georeference.measurements import (
    ROWS,
    FoundPriors,
    KnownPriors,
    Measurement,
    MeasurementErrors,
    _with,
    find_priors,
    kinds_given,
    move_models,
    settings_of,
)
from bundle.georeference.text_lines import ImageFinder, rows_of_images
from bundle.graphs.factors.factors import PositionFactor
from bundle.interface.georeference_options import GeoreferenceOptions
from bundle.interface.option_class import Options
from bundle.interface.option_fields import option
from bundle.reports.json_schema import described_entries
from tests.cli.conftest import run  # noqa: F401 (a fixture)
from tests.reports.page.reader import Page

FREE = 1e-200
"""Information of a coordinate that does not count."""


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class HeightOptions(Options):
    """Heights of images."""

    heights: str | None = option(
        None, "--heights", "measured heights: lines of image and metres", metavar="FILE",
        value="path",
    )  # fmt: skip
    height_sigma: float = option(
        0.5, "--height-sigma", "standard deviation of heights, in metres", metavar="METRES",
        needs=("heights",), above=0,
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class HeightPrior:
    image: int
    height: float
    sigma: float
    name = "HeightPrior"


@dataclasses.dataclass(frozen=True)
class KnownHeights(KnownPriors):
    priors: tuple[HeightPrior, ...]

    def errors_of(self, result):
        return HeightErrors(
            FoundHeights.make(result.problem, self.priors).residuals(result.problem)
        )


@dataclasses.dataclass(frozen=True)
class FoundHeights(FoundPriors):
    priors: tuple[HeightPrior, ...]
    rows: np.ndarray

    @staticmethod
    def make(problem, priors):
        return FoundHeights(tuple(priors), rows_of_images(problem, tuple(priors)))

    def factors(self, problem):
        return [
            PositionFactor(
                ("image", int(problem.image_ids[row])), (0.0, 0.0, prior.height),
                np.diag([FREE, FREE, prior.sigma**-2]),
            )
            for prior, row in zip(self.priors, self.rows, strict=True)
        ]  # fmt: skip

    def residuals(self, problem):
        heights = np.array([prior.height for prior in self.priors])
        return tuple((problem.projection_centers[self.rows, 2] - heights).tolist())


@dataclasses.dataclass(frozen=True)
class HeightErrors(MeasurementErrors):
    metres: tuple[float, ...]

    @property
    def entries(self):
        return {"heights": {"metres": self.metres}}

    @property
    def sentences(self):
        return [f"{len(self.metres)} heights, worst {max(map(abs, self.metres)):.3f} m."]

    @property
    def warnings(self):
        return ["Toy heights are not surveyed."]

    @property
    def displays(self):
        rows = tuple((str(k), f"{error:.4f}") for k, error in enumerate(self.metres))
        return [Display(title="Heights", head=("height", "error [toy m]"), rows=rows, most=2)]


def read_heights(problem, *, heights, height_sigma=0.5):
    finder = ImageFinder(problem)
    priors = []
    for number, line in enumerate(Path(heights).read_text().splitlines(), 1):
        name, height = line.split()
        image = finder.find(name, f"{heights}: line {number}: ")
        priors.append(HeightPrior(image, float(height), height_sigma))
    if not priors:
        raise InputError("heights: expected at least one, found 0")
    return KnownHeights(tuple(priors))


TOY = Measurement(
    noun="heights",
    source="heights",
    fields=("heights", "height_sigma"),
    title="heights of images",
    meaning="They are above z = 0.",
    read=read_heights,
    prior=HeightPrior,
    found=FoundHeights,
    entry="heights",
    moves=False,
    options=HeightOptions,
)


@pytest.fixture
def toy():
    ROWS.append(TOY)
    yield TOY
    ROWS.remove(TOY)


@pytest.fixture
def model(tmp_path):
    """A model, the file of six heights, and the residuals of its start in metres."""
    problem = bundle.synthesize(num_images=8, num_points=120, seed=5).problem
    names = tuple(f"image{image}.jpg" for image in problem.image_ids.tolist())
    problem = problem.replace(image_names=names)
    bundle.save(problem, tmp_path / "model", "colmap")
    away = np.array([0.3, -0.2, 0.1, 0.2, -0.1, 0.05])
    heights = bundle.load(tmp_path / "model").projection_centers[:6, 2] - away
    lines = [f"{name} {height!r}" for name, height in zip(names, heights.tolist(), strict=False)]
    (tmp_path / "heights.txt").write_text("\n".join(lines))
    return tmp_path, away


def refine(run, folder, *words):  # noqa: F811
    done = run(
        "refine", folder / "model", "-o", folder / "out", "--json", folder / "r.json",
        "--overwrite", *words,
    )  # fmt: skip
    assert done.code == 0, done.err
    return json.loads((folder / "r.json").read_text()), done.out


@pytest.mark.usefixtures("toy")
def test_flags_and_help_have_the_kind(run, model, capsys):  # noqa: F811
    for command in ("refine", "covariance", "diagnose"):
        with pytest.raises(SystemExit):
            run(command, "--help-all")
        text = capsys.readouterr().out
        assert "heights of images:" in text and "They are above z = 0." in text
        assert "--heights FILE" in text and "--height-sigma METRES" in text
    folder, _ = model
    words = ("refine", folder / "model", "-o", folder / "out", "--height-sigma")
    assert "--height-sigma: valid only with --heights" in run(*words, "1").err
    assert "--height-sigma" in run(*words, "-1", "--heights", folder / "heights.txt").err
    missing = run(*words, "1", "--heights", folder / "nowhere.txt")
    assert missing.code == 2 and "nowhere.txt" in missing.err
    poses = run(*words, "1", "--heights", folder / "heights.txt", "--refine", "points")
    assert poses.err.splitlines()[-1].startswith("error: --heights: expected poses in --refine")


def test_without_the_row_nothing_knows_it(run, model, capsys):  # noqa: F811
    with pytest.raises(SystemExit):
        run("refine", "--help-all")
    assert "--heights" not in capsys.readouterr().out
    with pytest.raises(InputError, match=r"priors: expected PositionPriors.* at \[0\]"):
        find_priors(bundle.load(model[0] / "model"), [HeightPrior(1, 0.0, 1.0)])


@pytest.mark.usefixtures("toy")
def test_the_solve_has_its_cost(run, model):  # noqa: F811
    folder, away = model
    plain, _ = refine(run, folder)
    before = plain["summary"]["initial_cost"]
    for sigma, words in ((0.5, ()), (1e-3, ("--height-sigma", "0.001"))):
        report, _ = refine(run, folder, "--heights", folder / "heights.txt", *words)
        own = 0.5 * float(((away / sigma) ** 2).sum())
        assert report["summary"]["initial_cost"] == pytest.approx(before + own, rel=1e-9)
        assert report["options"]["heights"].endswith("heights.txt")
    assert max(map(abs, report["heights"]["metres"])) < 0.01  # the solve follows them


@pytest.mark.usefixtures("toy")
def test_reports_and_page_show_it(run, model):  # noqa: F811
    folder, _ = model
    page, words = folder / "p.html", ("--heights", folder / "heights.txt")
    report, out = refine(run, folder, *words, "--html", page, "--verbose")
    errors = report["heights"]["metres"]
    worst = f"6 heights, worst {max(map(abs, errors)):.3f} m."
    assert worst in report["headline"] and worst in out
    assert "Toy heights are not surveyed." in out
    assert "error [toy m]" in out and f"{errors[1]:.4f}" in out
    assert f"2  {errors[2]:.4f}" not in out  # most=2
    text = " ".join(Page(page).words)
    assert "Heights" in text and "error [toy m]" in text and f"{errors[0]:.4f}" in text
    assert "heights" in described_entries()["refine"]


@pytest.mark.usefixtures("toy")
def test_covariances_count_it(run, model):  # noqa: F811
    folder, _ = model
    refine(run, folder)
    found = {}
    for name, words in (("plain", ()), ("toy", ("--heights", folder / "heights.txt"))):
        code, _, err = run("covariance", folder / "out", "-o", folder / "c.npz", "--json",
                           folder / "c.json", *words)  # fmt: skip
        assert code == 0, err
        found[name] = json.loads((folder / "c.json").read_text())["dof"]
    # Six factors of three residuals (two count nothing); heights determine four of seven motions
    # of the world: scale, height and two turns.
    assert found["toy"] == found["plain"] + 6 * 3 - 4


@pytest.mark.usefixtures("toy")
def test_it_moves_no_model():
    prior = HeightPrior(1, 0.0, 1.0)
    assert not move_models([prior])
    assert move_models([prior, bundle.PositionPrior(1, (0, 0, 0), 1.0)])
    assert not move_models([bundle.VelocityPrior(1, (0, 0, 0), 1.0)])


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class DepthOptions(Options):
    """Depths of images."""

    depths: str | None = option(None, "--depths", "measured depths", metavar="FILE", value="path")


def test_options_of_kinds_are_in_the_order_of_their_rows():
    own = [*HeightOptions.names(), *DepthOptions.names()]
    assert list(_with((HeightOptions, DepthOptions)).names()) == [
        *GeoreferenceOptions.names(),
        *own,
    ]
    assert list(_with(()).names()) == list(GeoreferenceOptions.names())


def test_kinds_of_one_source_are_given_once_with_all_options_of_their_reader():
    given = GeoreferenceOptions(
        orientations="xmp", images="photographs", velocities="v.txt", prior_loss="cauchy"
    )
    found = kinds_given(given)
    assert [row.noun for row in found] == ["orientations", "velocities"]
    assert settings_of(given, found[0]) == {
        "orientations": "xmp", "images": "photographs", "prior_loss": "cauchy",
    }  # fmt: skip
    assert settings_of(given, found[1])["velocities"] == "v.txt"
