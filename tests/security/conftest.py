"""A session whose names are attacks, and a running viewer of it."""

from pathlib import Path

import pytest
from cube_session import cube_session as cube_session, write_cube_session

# Names as a stranger's file may have them: what they hold must be shown, and do nothing.
NAMES = (
    "<img src=x onerror=document.title='taken'>",
    "[x](javascript:alert(1))",
    "<!--<script>",
    "</script><b>&amp;",
    "=1+1|' & {7*7} `*_\\",
)


def write_hostile_session(folder: Path, name: str) -> Path:
    """The cube's session, named as said; names of probings are checked, as files have them."""
    write_cube_session(folder)
    file = folder / "session.toml"
    text = file.read_text(encoding="utf-8")
    text = text.replace('name = "a [bold] cube"', f"name = '''{name}'''")
    file.write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="session")
def viewer(tmp_path_factory):
    """A running viewer that computes nothing."""
    pytest.importorskip("viser", reason="needs viser, the extra `view`, which is not installed")
    from palpate.viewer import Viewer, read_subject  # noqa: PLC0415
    from palpate.viewer.subject import BackgroundWork  # noqa: PLC0415

    folder = write_hostile_session(tmp_path_factory.mktemp("viewer") / "cube", NAMES[0])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackgroundWork, "start", lambda _: None)
        running = Viewer(read_subject(folder))
    yield running
    running.stop()
