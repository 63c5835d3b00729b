"""`palpate view`: a session or a result in a browser, or as a picture."""

import time
from pathlib import Path

from palpate.app.environment import check_cache
from palpate.app.terminal.output import print_text
from palpate.app.terminal.progress import progress_bar
from palpate.errors import InputError
from palpate.records import check_free
from palpate.viewer import Viewer, read_subject, write_screenshot, write_turntable


def view(
    subject: Path,
    /,
    *,
    session: Path | None = None,
    port: int | None = None,
    screenshot: Path | None = None,
    turntable: Path | None = None,
    probe: str | None = None,
    cache: Path | None = None,
    force: bool = False,
) -> int:
    """View an object in the browser: its probings, what the model predicts, how it feels.

    Colours show measured and predicted motion; sliders change the constants; a click presses a ball
    into the object, or sets support and contacts. The page is served by this computer, to this
    computer only, and only to who has the address that is printed. Ctrl-C ends it.

    Parameters
    ----------
    subject
        Session folder, or result folder of `palpate fit`.
    session
        Present location of a result's session, if it was moved.
    port
        Port of the page. Default: 8080, or the next free one.
    screenshot
        Write a picture (.png, .jpg) instead; needs neither browser nor display.
    turntable
        Write a turntable film (.mp4, .gif) instead.
    probe
        Probing to show in a picture or film. Default: the first.
    cache
        Folder in which to keep intermediate results for this object, for faster later runs.
    force
        Replace a picture or film of that name.

    Returns
    -------
    int
        0.
    """
    if screenshot is None and turntable is None and probe is not None:
        raise InputError("--probe is for --screenshot and --turntable; choose it in the page")
    for target in (screenshot, turntable):
        if target is not None:
            check_free(target, force=force)
    check_cache(cache)
    found = read_subject(subject, session)
    if screenshot is not None:
        write_screenshot(found, screenshot, probe=probe)
        print_text(f"Picture in {screenshot}", wrapped=False)
    if turntable is not None:
        with progress_bar() as progress:
            write_turntable(found, turntable, probe=probe, progress=progress)
        print_text(f"Film in {turntable}", wrapped=False)
    if screenshot is None and turntable is None:
        _serve(Viewer(found, port=port, cache=cache))
    return 0


def _serve(viewer: Viewer) -> None:
    """Until somebody ends it."""
    print_text(f"Open {viewer.address} in a browser; Ctrl-C ends it", wrapped=False)
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        print_text("The viewer has ended")
    finally:
        viewer.stop()
