"""HTML of the page: texts, and scales of colours. viser puts it into the page unchecked."""

from html import escape

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex

# As viser sets its own texts.
_STYLE = "padding:0 .8em .7em;font-size:.875rem;white-space:pre-line;overflow-wrap:anywhere"
_STOPS = 12


def text_html(text: str, *, bold: str = "", italic: bool = False) -> str:
    """HTML that shows a text as it is: what a file has put into it is no markup.

    Parameters
    ----------
    text : str                          line breaks are kept
    bold : str                          shown in bold before it
    italic : bool                       of a text that says what is not there, or not yet

    Returns
    -------
    str
    """
    shown = (f"<b>{escape(bold)}</b>" if bold else "") + escape(text)
    return f'<div style="{_STYLE}">{f"<i>{shown}</i>" if italic else shown}</div>'


def scale_html(top: float, unit: str, cmap: str) -> str:
    """A colour bar with its numbers, as HTML.

    Parameters
    ----------
    top : float                         value at its right end
    unit : str
    cmap : str                          colour map of matplotlib

    Returns
    -------
    str
    """
    stops = ", ".join(to_hex(c) for c in mpl.colormaps[cmap](np.linspace(0.0, 1.0, _STOPS)))
    numbers = "".join(f"<span>{value:.3g}</span>" for value in (0.0, top / 2))
    return (
        '<div style="margin:.3em 1em;font-size:.8em">'
        '<div style="height:.9em;border:1px solid #888;'
        f'background:linear-gradient(to right,{stops})">'
        '</div><div style="display:flex;justify-content:space-between">'
        f"{numbers}<span>{top:.3g} {unit} and more</span></div></div>"
    )
