"""Visit every built page in Chromium, on a bright desktop and a dark phone: ``python docs/_ext/browse.py [folder]``.

A page must load without an error on the console, show all its pictures and formulas, and be no wider than the screen.
A view of molecules must have drawn them. No network is needed, and none may be used.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from playwright.sync_api import Page, sync_playwright
from publish import publish

SCREENS = {"desktop": (1280, "light"), "phone": (390, "dark")}
TOO_WIDE = "() => document.documentElement.scrollWidth - document.documentElement.clientWidth"
UNLOADED = "() => [...document.images].filter((i) => !(i.complete && i.naturalWidth)).map((i) => i.src)"
RAW_FORMULAS = "() => [...document.querySelectorAll('.math')].filter((m) => !m.querySelector('mjx-container')).length"
NOT_DRAWN = "() => [...document.querySelectorAll('.viewer')].filter((v) => !(v.dataset.drawn > 0)).length"


class Quiet(SimpleHTTPRequestHandler):
    """Serve files and say nothing."""

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def faults(page: Page, address: str, host: str) -> list[str]:
    """Return what is wrong with a page."""
    found: list[str] = []
    page.on("console", lambda message: found.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: found.append(str(error)))
    page.on("request", lambda r: None if r.url.startswith((host, "data:", "blob:")) else found.append(f"asks {r.url}"))
    page.goto(address, wait_until="networkidle")
    if page.query_selector(".viewer"):
        page.wait_for_timeout(3000)
    if page.query_selector(".math"):
        page.wait_for_function(f"({RAW_FORMULAS})() === 0", timeout=20_000)
    page.evaluate("document.querySelectorAll('img').forEach((i) => (i.loading = 'eager'))")
    page.wait_for_load_state("networkidle")
    if (width := page.evaluate(TOO_WIDE)) > 0:
        found.append(f"{width} pixels too wide")
    found += [f"picture {source} did not load" for source in page.evaluate(UNLOADED)]
    if page.evaluate(NOT_DRAWN):
        found.append("the molecules were not drawn")
    return found


def main() -> None:
    """Visit all pages, published as the only version of a site, and say what is wrong."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/_build/html").resolve()
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    pages = [p.relative_to(folder) for p in sorted(folder.rglob("*.html")) if p.name != "genindex.html"]
    pages = [p for p in pages if not {"_static", "_modules"} & set(p.parts)]  # written, not made by Sphinx
    bad = 0
    with tempfile.TemporaryDirectory() as site, sync_playwright() as engine:
        publish(folder, Path(site), "dev")
        server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=site))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        host = f"http://127.0.0.1:{server.server_address[1]}"
        browser = engine.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--use-gl=swiftshader"])
        for name, (width, colours) in SCREENS.items():
            for path in pages:
                page = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=colours)
                for fault in faults(page, f"{host}/dev/{path.as_posix()}", host):
                    bad += 1
                    print(f"{path} ({name}): {fault}", flush=True)
                page.close()
    print(f"{len(pages)} pages on {len(SCREENS)} screens, {bad} faults")
    sys.exit(bad > 0)


if __name__ == "__main__":
    main()
