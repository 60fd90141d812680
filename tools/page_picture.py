"""Write the picture of the demo's report page: its first screen in a headless browser.

usage: python tools/page_picture.py [FILE]    (default: docs/report_page.png)

Without a browser the picture stays as it is.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

import bundle

ROOT = Path(__file__).resolve().parent.parent
MODEL = "data/street_colmap"
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
WIDTH, HEIGHT = 1400, 700
COLOURS = 128
FLAGS = (
    "--headless",
    "--no-sandbox",  # containers run as root, where Chromium's own sandbox does not start
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics card
    "--hide-scrollbars",
    "--virtual-time-budget=8000",
    "--blink-settings=preferredColorScheme=1",
    f"--window-size={WIDTH},{HEIGHT}",
)


def main(picture: Path) -> None:
    """Refine the model of the demo, write its page, and photograph the page."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        print(f"{picture} stays as it is: no browser, install one of {', '.join(BROWSERS)}")
        return
    with tempfile.TemporaryDirectory() as folder:
        page, screen = Path(folder) / "page.html", Path(folder) / "screen.png"
        result = bundle.solve_rounds(bundle.load(ROOT / MODEL), num_rounds=3, loss="cauchy")
        bundle.report(result, page, name=MODEL)
        command = [browser, *FLAGS, f"--screenshot={screen}", page.as_uri()]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL, timeout=120)
        with Image.open(screen) as image:
            small = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
            small.save(picture, optimize=True)
    print(f"{picture}: {picture.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "report_page.png")
