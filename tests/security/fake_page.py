"""A browser tab without a browser: its controls and texts, to be read and clicked."""

from contextlib import nullcontext
from types import SimpleNamespace
from unittest.mock import MagicMock

from palpate.viewer.server import Tab


class Control:
    """One element of the page."""

    def __init__(self, kind, label, value):
        self.kind, self.label, self.value, self.content = kind, label, value, label
        self.max, self.min, self.called, self.closed = value, 0, [], False

    def on_click(self, callback):
        self.called.append(callback)

    on_update = on_submit = on_click

    def click(self):
        for callback in self.called:
            callback(None)

    def close(self):
        self.closed = True

    remove = close

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


class Page:
    """Stands for the `GuiApi` of viser: any `add_...` makes a control."""

    def __init__(self):
        self.controls = []

    def __getattr__(self, name):
        def add(label="", *others, **_):
            value = others[0][0] if name == "add_dropdown" else others[-1] if others else None
            self.controls.append(Control(name.removeprefix("add_"), label, value))
            return self.controls[-1]

        return add

    def add_tab_group(self):
        return SimpleNamespace(add_tab=lambda _: nullcontext())

    def of_kind(self, *kinds):
        return [control for control in self.controls if control.kind in kinds]

    def button(self, label):
        """The last button with that label."""
        return [button for button in self.of_kind("button") if button.label == label][-1]


def opened_tab(background):
    """A tab of the viewer, and its page."""
    page = Page()
    client = SimpleNamespace(
        gui=page, scene=MagicMock(), camera=SimpleNamespace(aspect=1.6), atomic=nullcontext
    )
    return Tab(client, background), page
