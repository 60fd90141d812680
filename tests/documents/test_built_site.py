"""The site that `make docs` has built, in a browser: complete, quiet, offline, never too wide.

Without `make docs` before, these tests are skipped; CI runs it. Warnings, of dead links too, fail
there. Nothing is built here.
"""

import os
from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest

from bundle.interface.option_class import OPTION_CLASSES
from tests.reports.page.conftest import browser  # noqa: F401 (a fixture)

SITE = Path(__file__).parents[2] / "build" / "site"
THEORY = (Path(__file__).parents[2] / "docs" / "theory").glob("*.md")
PAGES = [
    "index.html",
    "overview.html",
    "reference/options.html",
    "api/solving.html",
    "theory/trust_region.html",
    "tutorials/first_refinement.html",
]


@pytest.fixture
def site():
    if not (SITE / "index.html").is_file():
        reason = "no site: run `make docs`"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return SITE


@pytest.mark.parametrize("page", PAGES)
def test_a_page_asks_for_nothing_and_fits(browser, site, page):  # noqa: F811
    for scheme, width in [("light", 1400), ("dark", 390)]:
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        browser.call("Emulation.setEmulatedMedia", features=features)
        browser.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=900, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        browser.open(site / page)
        assert browser.complaints() == []
        assert [url for url in browser.requested() if not url.startswith("file:")] == []
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        shade = browser.evaluate("getComputedStyle(document.body).backgroundColor")
        light = sum(int(part) for part in shade.strip("rgba()").split(",")[:3]) / 3 > 128
        assert light == (scheme == "light")
    browser.call("Emulation.clearDeviceMetricsOverride")
    browser.call("Emulation.setEmulatedMedia", features=[])


@pytest.mark.parametrize("page", PAGES)
def test_images_and_links_of_a_page_are_there(browser, site, page):  # noqa: F811
    browser.open(site / page)
    broken = "[...document.images].filter((i) => i.complete && i.naturalWidth === 0).length"
    assert browser.evaluate(broken) == 0
    targets = browser.evaluate("[...document.links].map((a) => a.href)")
    assert len(targets) > 20
    for target in targets:
        parts = urlparse(target)
        if parts.scheme == "file":
            path = Path(unquote(parts.path))
            assert path.is_file(), target
            anchor = unquote(parts.fragment)
            if anchor and path.suffix == ".html":
                assert f'id="{anchor}"' in path.read_text(encoding="utf-8"), target


def test_members_of_a_class_are_there_also_inherited_ones(browser, site):  # noqa: F811
    browser.open(site / "api" / "graphs.html")
    for name in ("FactorGraph.add_factor", "FactorGraph.solve", "LinearPrior.reanchor"):
        assert browser.evaluate(f"document.getElementById('bundle.{name}') !== null"), name


TERMS = ["preintegration", "fill-in", "first-estimate Jacobians", "FEJ", "fixed-lag", "null space"]
TERMS += ["clique", "nnz(L)", "telemetry", "full report"]


@pytest.mark.parametrize("term", TERMS)
def test_search_finds_terms_of_the_literature_without_a_server(browser, site, term):  # noqa: F811
    browser.open(site / "search.html")
    browser.evaluate(f"Search.performSearch('{term}')")
    browser.wait_for("document.querySelectorAll('#search-results li').length > 0")


def test_every_option_class_is_on_the_page_of_options(browser, site):  # noqa: F811
    browser.open(site / "reference" / "options.html")
    for name in OPTION_CLASSES:
        assert browser.count(f"section#{name.lower()} dt") >= 1, name


def test_notebooks_show_what_they_computed(browser, site):  # noqa: F811
    browser.open(site / "tutorials" / "first_refinement.html")
    assert browser.count(".cell_output img") == 1
    assert "7 null directions" in browser.evaluate("document.body.textContent")


@pytest.mark.parametrize("page", sorted(path.stem for path in THEORY), ids=str)
def test_theory_has_rendered_formulas(browser, site, page):  # noqa: F811
    browser.open(site / "theory" / f"{page}.html")
    assert browser.count('div.formula > math[display="block"]') >= (1 if page == "index" else 2)
    # A row without ascenders has 14 px in Debian 13's Chromium, a formula that is not drawn none.
    high = "[...document.querySelectorAll('div.formula math')].every((m) => m.clientHeight > 10)"
    assert browser.evaluate(high)
    assert browser.evaluate("document.querySelector('article').textContent").count("$$") == 0


def test_derivations_are_those_of_the_sources(browser, site):  # noqa: F811
    browser.open(site / "theory" / "losses.html")
    formula = "J~ = sqrt(rho') (I - alpha r r^T / s) J"
    assert formula in (SITE.parents[1] / "cpp/core/factors/loss.h").read_text()
    assert formula in browser.evaluate("document.body.textContent")
    browser.open(site / "robust_kernels.html")
    assert browser.count("a[href='theory/losses.html#cpp-core-factors-loss-h']") == 1
