"""The pictures of the pages, for README and the documentation, from the code as it is.

``make pictures`` runs this file. It carries out the demonstration, shows its report and the live page in Chromium, and
writes the checksum of the page's sources beside the pictures. A test compares this checksum with the sources.
"""

import hashlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).parent
PAGE = DOCS.parent / "sugiyama_ros" / "page"
CHECKSUM = DOCS / "pictures.sha256"
SUGIYAMA = str(Path(sys.executable).with_name("sugiyama"))
_PORT, _WIDTH, _HEIGHT = 5099, 1280, 900
# What the live page says once it has shown 100 s of the recording, however fast the machine is.
_ENOUGH = re.compile(r"^(1|2)\d\d s: one-step error")
_READY = "window.Bokeh && Bokeh.documents.length && Bokeh.documents[0].is_idle"


def checksum() -> str:
    """SHA-256 of all sources of the pages, with their names."""
    found = hashlib.sha256()
    for path in sorted(PAGE.rglob("*.py")):
        found.update(f"{path.relative_to(PAGE)}\n".encode() + path.read_bytes())
    return found.hexdigest()


def main() -> None:
    """Make all pictures."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        subprocess.run([SUGIYAMA, "demo"], cwd=folder, check=True)
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        shown = browser.new_page(viewport={"width": _WIDTH, "height": _HEIGHT})
        shown.goto((folder / "sugiyama-demo.html").as_uri())
        shown.wait_for_function(_READY)
        shown.wait_for_timeout(1000)
        shown.screenshot(path=DOCS / "report.png")
        source = ["sugiyama-demo.mcap", "--rate", "4", "--port", str(_PORT)]
        live = subprocess.Popen([SUGIYAMA, "live", *source], cwd=folder, stderr=subprocess.PIPE, text=True)
        try:
            assert live.stderr is not None
            for _ in range(2):  # starting; the address
                live.stderr.readline()
            shown.goto(f"http://localhost:{_PORT}")
            shown.get_by_text(_ENOUGH).wait_for(timeout=600_000)
            shown.screenshot(path=DOCS / "live.png", full_page=True)
        finally:
            browser.close()
            live.send_signal(signal.SIGINT)
            live.wait(60)
    CHECKSUM.write_text(checksum() + "\n")


if __name__ == "__main__":
    main()
