"""A cube with Green's functions, and one viewer that all browser tests share."""

import pytest
from browser_help import browser as browser, until
from cube_green import green as green, session as session
from cube_session import cube_session as cube_session, write_cube_session

# A name that would act in a page that took it as markup.
NAME = '<img src=x onerror="document.body.dataset.taken=1">[a](b)'


@pytest.fixture(scope="session")
def viewer(tmp_path_factory):
    """A running viewer of the cube, its model and Green's functions ready."""
    pytest.importorskip("viser", reason="needs viser, the extra `view`, which is not installed")
    from palpate.viewer import Viewer, read_subject  # noqa: PLC0415

    folder = write_cube_session(tmp_path_factory.mktemp("viewer") / "cube")
    file = folder / "session.toml"
    file.write_text(file.read_text().replace('"a [bold] cube"', f"'{NAME}'"))
    running = Viewer(read_subject(folder))
    yield running
    running.stop()


@pytest.fixture(scope="module")
def page(browser, viewer):
    """A tab that shows the cube, and the addresses that it asked for, as `page.asked`."""
    before = set(viewer.tabs)
    tab = browser.new_page(viewport={"width": 800, "height": 500})
    tab.asked = []
    tab.on("request", lambda request: tab.asked.append(request.url))
    tab.goto(viewer.address)
    until(lambda: set(viewer.tabs) - before)
    tab.number = max(viewer.tabs)
    tab.wait_for_selector("canvas")
    until(lambda: viewer.background.green is not None)
    yield tab
    tab.close()
