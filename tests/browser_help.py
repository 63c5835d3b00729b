"""A browser without a display, and waiting for what it and other threads bring about."""

import shutil
import time

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome") or shutil.which("chrome")
# Software draws: no graphics card, no display.
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def until(condition, patience=60.0):
    """Wait until a condition holds; fail where it does not in time."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium, which ends with the file of tests that drives it: its driver keeps an
    event loop running in this thread, where no second one may start."""
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="needs playwright to drive a browser, which is not installed"
    )
    if CHROMIUM is None:
        pytest.skip("needs a Chromium browser, which is not installed")
    with sync_api.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield started
        started.close()
