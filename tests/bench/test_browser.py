"""A person in a real browser measures the virtual bench by hand, from mesh to constants."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from bench.drawn_world import Hand, Script, hand_bench
from browser_help import browser as browser

from palpate.bench import Page, measure, wanted_precision
from palpate.records import read_session

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:Queued a")]
# A fit, kernels that may have to be compiled, on a busy machine [ms].
PATIENCE = 300_000


class HandPage(Page):
    """The page of a person whose hand does what it says, where it says."""

    def __init__(self, bench):
        super().__init__("ball", port=None, on_message=lambda _: None)
        self.hand = Hand(bench)

    def place(self, point, inward):
        super().place(point, inward)
        self.hand.there = point, inward

    def tell(self, text):
        super().tell(text)
        self.hand(text)


@pytest.fixture
def bench(tmp_path, monkeypatch):
    pytest.importorskip("viser", reason="needs viser, the extra `view`, which is not installed")
    monkeypatch.setattr("palpate.bench.pushing._PATIENCE", 600.0)
    return hand_bench(tmp_path)


def test_the_whole_way_by_hand(browser, bench, tmp_path):
    """Six decisions for two pushes; another tab takes over, and nothing is asked twice."""
    page, session = HandPage(bench), tmp_path / "session"
    session.mkdir()
    decided = []

    def decide(tab, label):
        tab.get_by_role("button", name=label, exact=True).click(timeout=PATIENCE)
        decided.append(label)

    with ThreadPoolExecutor(1) as thread:
        try:
            until = wanted_precision("E 0.1 %")
            running = thread.submit(measure, bench, page, session, until=until)
            tab = browser.new_page(viewport={"width": 700, "height": 500})
            tab.goto(page.address)
            tab.get_by_text("ball.stl is 80 x 79.8 x 40; in which unit?").wait_for(timeout=PATIENCE)
            tab.get_by_text("focus good").first.wait_for(timeout=PATIENCE)
            decide(tab, "mm")
            decide(tab, "loose")
            decide(tab, "ball")
            decide(tab, "OK")
            decide(tab, "Ready")
            tab.get_by_text("Push 1 is taken").wait_for(timeout=PATIENCE)
            tab.close()
            other = browser.new_page(viewport={"width": 390, "height": 600})
            other.goto(page.address)
            decide(other, "Ready")
            other.get_by_text("After push 2").wait_for(timeout=PATIENCE)
            other.get_by_role("button", name="Ready", exact=True).wait_for(timeout=PATIENCE)
            assert other.locator("circle").count() == 4
            other.get_by_role("button", name="Stop measuring").click()
            estimate = running.result(timeout=1e-3 * PATIENCE)
        finally:
            page._stopped.set()
            page.close()
    assert decided == ["mm", "loose", "ball", "OK", "Ready", "Ready"]
    assert len(estimate.probes) == 2
    # The flat side that was marked is that of the half ball.
    written = read_session(session)
    held = written.mesh.vertices[written.mesh.triangles[written.held_triangles]]
    np.testing.assert_allclose(held[..., 2], 0.0, atol=1e-9)
    # Gone on with, nothing of that is asked again.
    script = Script()
    measure(bench, script, session, pushes=2)
    assert script.asked == []
