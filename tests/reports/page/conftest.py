"""A real browser for the tests of pages."""

import os
from collections.abc import Iterator

import pytest

from tests.reports.page.browser import NAMES, Browser, find_browser


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Headless Chromium; without one a test is skipped, under CI=true it fails."""
    command = find_browser()
    if command is None:
        reason = f"no browser: install one of {', '.join(NAMES)}"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    with Browser(command, tmp_path_factory.mktemp("chromium")) as found:
        yield found
