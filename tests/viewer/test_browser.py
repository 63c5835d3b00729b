"""The viewer in a real browser without a display."""

import io
from dataclasses import replace
from urllib.parse import urlsplit

import numpy as np
import pytest
from browser_help import until
from PIL import Image

from palpate.records import ModulusMap
from palpate.solids import make_solid

pytestmark = pytest.mark.filterwarnings("ignore:Queued a")


def canvas(page):
    """What the page shows of the object: the middle, as pixels."""
    shot = page.screenshot(clip={"x": 140, "y": 100, "width": 200, "height": 300})
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), dtype=float)


def changed(page, before):
    """Whether the picture is another one by now."""
    return np.abs(canvas(page) - before).mean() > 2.0


def drawn(page):
    """Whether something stands before the white ground."""
    return (canvas(page).min(axis=2) < 200).mean() > 0.02


def click(page, column, row, happened):
    """Click until something happens: a page that is still setting up its view loses a click."""
    for _ in range(10):
        page.mouse.click(column, row)
        try:
            until(happened, patience=6.0)
        except AssertionError:
            continue
        return
    until(happened, patience=1.0)


def test_the_mesh_is_there_and_no_other_host_is_asked(page, viewer):
    until(lambda: drawn(page))
    asked = {address.removeprefix("blob:") for address in page.asked}
    home = f"http://{urlsplit(viewer.address).netloc}/"
    assert all(address.startswith((home, "data:")) for address in asked), asked


def test_a_name_is_shown_as_it_is_and_does_nothing(page, viewer):
    page.get_by_text(viewer.background.subject.session.name).first.wait_for(timeout=10_000)
    assert page.locator("body").get_attribute("data-taken") is None
    assert page.locator("a[href=b]").count() == 0


def test_writing_waits_for_an_answer(page, viewer):
    tab, written = viewer.tabs[page.number], []
    tab.setting._write = lambda: written.append(True)
    tab.setting.draft = tab.setting.draft.with_support(np.arange(9))
    page.get_by_role("tab", name="Set up").click()
    page.get_by_role("button", name="write session.toml").click()
    page.get_by_text("support_triangles.txt is new").wait_for(timeout=10_000)
    assert written == []
    page.get_by_role("button", name="write", exact=True).click()
    until(lambda: written == [True])
    tab.setting._forget()


def test_a_click_presses_and_a_drag_presses_deeper(page, viewer):
    tab = viewer.tabs[page.number]
    until(lambda: drawn(page))
    page.get_by_role("tab", name="Touch").click()
    before = canvas(page)
    click(
        page, 240, 250,
        lambda: tab.touching.pressed is not None and tab.touching.pressed.force.any(),
    )  # fmt: skip
    first = tab.touching.pressed
    page.get_by_text(f"{np.linalg.norm(first.force):.3g}").first.wait_for(timeout=10_000)
    until(lambda: changed(page, before))
    page.mouse.down()
    for step in range(1, 8):
        page.mouse.move(240 + 8 * step, 250)
        page.wait_for_timeout(60)
    page.mouse.up()
    # More depth, more force: the drag's length is that of the ball's way.
    until(lambda: tab.touching.pressed.depth > first.depth)
    assert np.linalg.norm(tab.touching.pressed.force) > np.linalg.norm(first.force)


def test_no_press_is_lost_while_the_object_is_drawn_anew(page, viewer, monkeypatch):
    """A deformed body that a browser still takes in cannot be clicked, but the place can."""
    tab, pressed = viewer.tabs[page.number], []
    monkeypatch.setattr(tab.touching, "put", pressed.append)
    until(lambda: drawn(page))
    mesh = tab.stage.subject.session.mesh
    for number in range(1, 9):
        tab.stage.draw_body(np.full_like(mesh.vertices, 1e-6 * number), None)
        page.mouse.click(240, 250)
        until(lambda number=number: len(pressed) == number, patience=5.0)


def test_a_stiff_part_is_seen_through_the_object(page, viewer, monkeypatch):
    stage = viewer.tabs[page.number].stage
    solid = make_solid(stage.subject.session.mesh, edge=6e-3)
    tetrahedra, middle = solid.elements[:, :4], solid.nodes.mean(axis=0)
    inside = np.linalg.norm(solid.nodes[tetrahedra].mean(axis=1) - middle, axis=1) < 0.012
    modulus = ModulusMap(
        solid.nodes, tetrahedra, 2.0 * inside, np.full(len(inside), 0.1), inside | True,
        np.zeros((0, len(inside))),
    )  # fmt: skip
    monkeypatch.setattr(stage, "subject", replace(stage.subject, modulus=modulus))

    def red():
        # Nothing else is: points are from blue over green to yellow.
        colour = canvas(page)
        return (colour[..., 0] - colour[..., 1] > 40.0).mean() > 0.01

    until(lambda: drawn(page))
    assert not red()
    stage.draw_through()
    until(red)
    stage.close()
    until(lambda: not red())


def test_a_slider_asks_the_model(page, viewer):
    tab = viewer.tabs[page.number]
    page.get_by_role("tab", name="Material").click()
    until(lambda: tab.material.modulus is not None)
    before, was = float(tab.material.modulus.value), tab.material.text.content
    assert "misfit 0.0" in was
    thumb = page.get_by_role("slider").first
    thumb.focus()
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    until(lambda: float(tab.material.modulus.value) > before)
    until(lambda: tab.material.text.content != was)


def test_two_tabs_do_not_disturb_each_other_and_a_closed_one_goes(page, viewer, browser):
    others = set(viewer.tabs)
    second = browser.new_page(viewport={"width": 800, "height": 500})
    second.goto(viewer.address)
    until(lambda: len(viewer.tabs) > len(others))
    mine, theirs = viewer.tabs[page.number], viewer.tabs[max(viewer.tabs)]
    until(lambda: drawn(page))
    until(lambda: drawn(second))
    page.bring_to_front()
    page.get_by_role("tab", name="Material").click()
    until(lambda: theirs.material.modulus is not None)
    before, other = float(mine.material.modulus.value), float(theirs.material.modulus.value)
    slider = page.get_by_role("slider").first
    slider.focus()
    page.keyboard.press("ArrowLeft")
    until(lambda: float(mine.material.modulus.value) < before)
    assert float(theirs.material.modulus.value) == other
    second.close()
    until(lambda: set(viewer.tabs) == others)
    # The server goes on for the other.
    now = float(mine.material.modulus.value)
    page.keyboard.press("ArrowLeft")
    until(lambda: float(mine.material.modulus.value) < now)
