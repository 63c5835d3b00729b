"""What several threads may ask of a tab at once."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

from palpate.viewer.server import Tab


class _Folder:
    """A folder of controls as viser has it: open once at a time."""

    def __init__(self) -> None:
        self.is_open = False

    def __enter__(self) -> None:
        assert not self.is_open
        self.is_open = True
        time.sleep(1e-3)

    def __exit__(self, *_: object) -> None:
        self.is_open = False


def test_a_tab_is_updated_by_one_thread_at_a_time() -> None:
    """The background work says that something is ready while the tab is opened."""
    tab = Tab.__new__(Tab)
    tab._updating = threading.Lock()
    tab._material_folder = _Folder()
    tab.material = tab.touching = SimpleNamespace(update=lambda: None)
    tab._background, tab._fitted = SimpleNamespace(fitted=None), None
    with ThreadPoolExecutor(8) as threads:
        for done in [threads.submit(tab.update) for _ in range(32)]:
            done.result()
