"""A real browser for tests: Debian's chromium, drawing WebGL in software, driven by Playwright."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def _missing(what: str) -> None:
    """Skip where something is missing; in CI nothing may be."""
    if os.environ.get("CI"):
        pytest.fail(f"{what} is missing; browser tests must not skip in CI")
    pytest.skip(f"{what} is missing: apt-get install chromium, pip install playwright")


@contextmanager
def open_browser() -> Iterator:
    """A Playwright browser with a fresh profile."""
    executable = (
        shutil.which("chromium")
        or shutil.which("chromium-browser")
        or shutil.which("google-chrome")
    )
    if executable is None:
        _missing("a chromium browser")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        _missing("playwright")
    with tempfile.TemporaryDirectory() as home, sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=executable, args=FLAGS, env={**os.environ, "HOME": home}
        )
        try:
            yield browser
        finally:
            browser.close()


def wait_for(condition: Callable[[], bool], seconds: float, pause: float = 0.2) -> bool:
    """Whether the condition came true in time."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(pause)
    return False
