"""The page's side of the conversation, with controls that nobody draws."""

import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import cv2
import numpy as np
import pytest
from bench.drawn_world import DOWN, TOP, drawn_body, small_config
from browser_help import until
from estimate_samples import constants
from security.fake_page import Page as Controls
from surfaces import box

from palpate.bench import DeviceError, Page
from palpate.bench.page_parts import montage, trace_svg, verdicts
from palpate.bench.questions import AT_REST, Stopped
from palpate.lab import make_head
from palpate.records import CONSTANT_NAMES, Estimate, ProbeEstimate, Status
from palpate.vision import project


class Gui(Controls):
    """Those of one column; the other's are among them."""

    def __init__(self):
        super().__init__()
        self.main_panel = MagicMock()

    def add_panel(self):
        return MagicMock(add_tab=lambda _: nullcontext())

    def open_button(self, label):
        """That button, once it is there."""
        buttons = []

        def there():
            buttons[:] = [
                button
                for button in self.of_kind("button")
                if button.label == label and not button.closed
            ]
            return buttons

        until(there, patience=10.0)
        return buttons[-1]


@pytest.fixture
def page(monkeypatch):
    server = MagicMock(gui=Gui())
    monkeypatch.setattr("palpate.bench.page.open_server", lambda *_: (server, "address"))
    made = Page("ball", port=None, on_message=lambda _: None)
    made.gui = server.gui
    return made


@pytest.fixture
def asking(page):
    with ThreadPoolExecutor(1) as thread:
        yield thread.submit
        page._stopped.set()


@pytest.fixture(scope="module")
def seen():
    """The rig of the drawn world, and what it sees at rest."""
    config = small_config()
    rig = make_head(config.head, config.specimen.mesh)
    body = drawn_body(config, rig)
    return rig, tuple(np.rint(p).astype(np.uint8) for p in body.draw(body.vertices, None))


def test_an_answer_is_the_button_that_was_pressed(page, asking):
    answer = asking(page.choose, "In which unit?", ["mm", "cm"])
    page.gui.open_button("mm")
    page.gui.open_button("cm").click()
    assert answer.result() == "cm"
    assert all(
        button.closed for button in page.gui.of_kind("button") if button.label in ("mm", "cm")
    )


@pytest.mark.parametrize(("typed", "answer"), [(None, "6"), (" 46 g ", "46 g"), ("", "6")])
def test_a_field_that_is_left_empty_means_the_usual(page, asking, typed, answer):
    asked = asking(page.ask, "Radius?", "6")
    page.gui.open_button("OK")
    (field,) = page.gui.of_kind("text")
    field.value = field.value if typed is None else typed
    (form,) = page.gui.of_kind("form")
    form.click()
    assert asked.result() == answer


def test_pictures_are_live_while_a_question_is_open(page, asking, seen):
    """A camera that fails then is said, and is no answer."""
    rig, pictures = seen
    shown = [pictures]

    def look():
        if not shown:
            raise DeviceError("camera 'c0': it has stopped sending")
        return shown.pop()

    page.watch([camera.name for camera in rig.cameras], look)
    answer = asking(page.wait, "Tool off")
    until(lambda: "it has stopped sending" in page._state.content, patience=10.0)
    assert page._picture.image.shape[1] == 640
    assert "texture good" in page._verdicts.content
    assert not answer.done()
    page.gui.open_button("Ready").click()
    answer.result()


def test_stop_ends_a_question_and_a_push(page, asking, seen):
    answer = asking(page.wait, "Tool off")
    page.gui.open_button("Ready")
    page.gui.open_button("Stop measuring").click()
    with pytest.raises(Stopped):
        answer.result()
    with pytest.raises(Stopped):
        page.see(seen[1], [], [], "press")


def test_a_click_says_what_is_held(page, asking):
    """The largest side unless another is clicked on; one more with the shift key."""
    mesh = box(size=(0.04, 0.04, 0.02), cells=2)
    normal = np.cross(*(mesh.vertices[mesh.triangles[:, k]] - mesh.vertices[mesh.triangles[:, 0]]
                        for k in (1, 2)))  # fmt: skip
    sides = {name: np.flatnonzero(normal[:, axis] * sign > 0.0)
             for name, axis, sign in (("z-", 2, -1), ("z+", 2, 1), ("x-", 0, -1))}  # fmt: skip
    ray = {
        "z+": ([20.0, 20.0, 90.0], [0.0, 0.0, -1.0]),
        "x-": ([-90.0, 20.0, 5.0], [1.0, 0.0, 0.0]),
    }

    def asked(*clicks):
        answer = asking(page.face, mesh, {"z-": sides["z-"]}, ["loose", "glued"])
        until(lambda: page._clicked is not None)
        for name, more in clicks:
            event = SimpleNamespace(ray_origin=ray[name][0], ray_direction=ray[name][1])
            page._click(event, more=more)
        page.gui.open_button("glued").click()
        held, way = answer.result()
        assert way == "glued"
        return held.tolist()

    assert asked() == sides["z-"].tolist()
    assert asked(("z+", False)) == sides["z+"].tolist()
    assert asked(("z+", False), ("x-", True)) == sorted([*sides["z+"], *sides["x-"]])


def test_a_curve_needs_a_click(page, asking):
    answer = asking(page.face, box(), {}, ["loose"])
    page.gui.open_button("loose").click()
    until(lambda: "Nothing is marked yet" in page._log.content)
    page._click(
        SimpleNamespace(ray_origin=[500.0, 500.0, 9e3], ray_direction=[0.0, 0.0, -1.0]), more=True
    )
    page.gui.open_button("loose").click()
    assert len(answer.result()[0]) == 2


def estimate(count, *, known=True):
    probes = [
        ProbeEstimate(f"n{k:02d}", **constants(), observed=20, missing=1, rejected=0,
                      rms_residual=2e-4, prediction_error=None)
        for k in range(count)
    ]  # fmt: skip
    identifiable = dict.fromkeys(CONSTANT_NAMES, known)
    return Estimate(
        status=Status.from_identifiable(identifiable), **constants(), identifiable=identifiable,
        probes=tuple(probes), seconds={}, method="reduced", settings={}, notes=(),
    )  # fmt: skip


def test_constants_are_shown_with_a_point_for_each_push(page):
    page.judged(estimate(1, known=False))
    assert "not determined" in page._table.content
    assert page._plots.content == ""
    page.judged(estimate(2))
    page.judged(estimate(3))
    assert "60.0 \N{PLUS-MINUS SIGN} 1.2 kPa" in page._table.content
    # Two pushes with an interval of E, and of nu.
    assert page._plots.content.count("<circle") == 4


def test_pictures_are_judged_as_a_person_would(seen):
    _, (picture, *_) = seen

    def words(changed):
        return [
            text for text, good in verdicts(np.clip(changed, 0, 255).astype(np.uint8)) if not good
        ]

    assert words(picture) == []
    assert words(cv2.GaussianBlur(picture, (0, 0), 6.0)) == ["blurred, or coarse speckle: focus"]
    assert words(picture * 0.1)[0] == "dark: more light"
    assert "white: less light" in words(picture * 4.0)[0]
    assert words(np.full_like(picture, 100)) == ["no texture: speckle the object"]


def test_a_ring_is_where_to_press(seen):
    """Orange where a camera sees the place, grey on the far side of the object."""
    rig, pictures = seen
    camera, tile = rig.cameras[0], 320
    for inward, colour in ((DOWN, (213, 94, 0)), (-DOWN, (138, 143, 152))):
        sheet = montage("abc", pictures, rig, target=(TOP, inward))
        scale = tile / pictures[0].shape[1]
        x, y = scale * (project(camera, TOP[None])[0] + 0.5)
        assert tuple(sheet[round(y), round(x - 21)]) == colour
    assert montage("ab", pictures[:2]).shape[:2] == (1024, 640)


def test_a_push_goes_up_whichever_way_a_gauge_counts():
    time = np.linspace(0.0, 3.0, 301)
    push = 0.2 + np.clip(time - 1.0, 0.0, 0.5)
    assert trace_svg(time.tolist(), push.tolist()) == trace_svg(time.tolist(), (-push).tolist())
    # Nothing yet, and readings that came all at once.
    assert trace_svg([], []) == trace_svg([1.0, 1.0], [0.1, 0.2]) == ""


def test_motion_and_force_are_one_line_of_an_elastic_body():
    """The same path, twice; and half of it where half as much has moved in the end."""
    time = np.linspace(10.0, 13.0, 51)
    push = np.clip(time - 11.0, 0.0, 0.5)

    def paths(motion):
        svg = trace_svg(time.tolist(), push.tolist(), list(zip(time, motion, strict=True)))
        return re.findall(r'd="(M[^"]*)" fill="none" stroke="#(?!8)', svg), svg

    (force, motion), svg = paths(4e-3 * push)
    assert force == motion
    assert "2 mm" in svg
    (force, motion), _ = paths(np.where(time > 12.0, 2e-3, 4e-3) * push)
    assert force.split("L")[:30] == motion.split("L")[:30]
    assert force.split("L")[-1] != motion.split("L")[-1]


def test_motion_near_the_tool_is_followed_while_it_is_pressed(page, seen):
    """A push of 2 mm down: rest pictures do not move, later ones do, and the next rest forgets."""
    rig, rest = seen
    mesh = small_config().specimen.mesh
    page.known(rig)
    page.body(mesh, np.zeros(0, dtype=np.int64))
    page.place(TOP, DOWN)
    body = drawn_body(small_config(), rig)
    gap = np.linalg.norm(body.vertices - TOP, axis=1)
    dented = body.vertices + 2e-3 * np.exp(-((gap / 0.015) ** 2))[:, None] * DOWN
    pressed = tuple(np.rint(p).astype(np.uint8) for p in body.draw(dented, None))
    page.see(rest, [0.0], [0.0], AT_REST)
    page.see(rest, [0.1], [0.0], "press")
    until(lambda: page._motion._work.done(), patience=60.0)
    for when, pictures in ((0.2, rest), (0.3, pressed)):
        page.see(pictures, [when], [0.0], "press")
        until(lambda: page._motion._work.done(), patience=60.0)
    (first, still), (second, moved) = page._motion.trace[-2:]
    assert (first, second) == (0.2, 0.3)
    assert abs(still) < 1e-5
    # The twenty nearest of points every 9 pixels, 2 mm apart: within 6 mm, where it is 1.7 to 2 mm.
    assert 1.6e-3 < moved < 2.05e-3
    page.see(rest, [0.4], [0.0], AT_REST)
    assert page._motion is None


def test_an_object_is_dragged_over_the_pictures(page, asking, seen):
    """By 3 mm along x and a right angle about z; untouched, it lies where it is."""
    rig, pictures = seen
    mesh, scene = small_config().specimen.mesh, page._server.scene
    page.watch([camera.name for camera in rig.cameras], lambda: pictures)

    def asked(*drags):
        handle = scene.add_transform_controls.return_value = MagicMock(wxyz=(1.0, 0.0, 0.0, 0.0))
        answer = asking(page.over, rig, mesh, Path("object.png"))
        until(lambda: handle.on_update.called)
        handle.position = scene.add_transform_controls.call_args.kwargs["position"]
        for wxyz, shift in drags:
            handle.wxyz, handle.position = wxyz, np.array(handle.position) + shift
            handle.on_update.call_args.args[0](None)
        shown = page._outline.vertices
        page.gui.open_button("It lies there").click()
        return answer.result(), shown

    motion, shown = asked()
    assert motion is None
    np.testing.assert_array_equal(shown, mesh.vertices)
    motion, shown = asked(((np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)), [3.0, 0.0, 0.0]))
    turn, shift = motion[:3, :3], motion[:3, 3]
    np.testing.assert_allclose(turn, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(shown, mesh.vertices @ turn.T + shift)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = 0.5 * (low + high)
    moved = turn @ middle + shift - middle
    np.testing.assert_allclose(moved, [3e-3, 0.0, 0.0], atol=1e-15)


def test_outline_and_dots_are_drawn_over_the_pictures(seen):
    """The outline of the half ball is where the picture goes from the object to the dark."""
    rig, pictures = seen
    mesh = small_config().specimen.mesh
    names = [camera.name for camera in rig.cameras]
    dots = [np.array([[20.0 + 40 * k, 300.0]]) for k in range(3)]
    plain = montage(names, pictures).astype(int)
    sheet = montage(names, pictures, rig, outline=mesh, dots=dots).astype(int)
    drawn = (np.abs(sheet - plain).sum(axis=2) > 0)[:256, :320]
    assert tuple(sheet[round(0.8 * 300.5), round(0.8 * 20.5)]) == (213, 94, 0)
    drawn[230:] = False
    # Shares of the pixels on the line that have the dark of the background, and the object, nearby.
    grey = cv2.resize(pictures[0], (320, 256), interpolation=cv2.INTER_AREA)
    low, high = (f(grey, np.ones((5, 5))) for f in (cv2.erode, cv2.dilate))
    assert drawn.sum() > 300
    assert ((low[drawn] < 15) & (high[drawn] > 40)).mean() > 0.95
