"""A table that fits any terminal: where columns have no room, they go on below."""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions
from rich.markup import escape
from rich.table import Table
from rich.text import Text

# Headings go on in the next line where there is no room, but are not squeezed to less than this.
_HEADING_WIDTH = 7
# A cell that begins like this makes its column one of words, which are set to the left.
_WORD = re.compile(r"(?!unknown|nan|inf|not determined)[A-Za-z\[]")
# Words may go on in the next line, but not be squeezed to less, nor names to less than that.
_WORDS_WIDTH, _NAMES_WIDTH = 16, 32
# What stands beside every column, and at the end.
_COLUMN_PADDING, _FRAME_WIDTH = 2, 1


class ShownTable(Table):
    """A table of `terminal_table` that remembers its cells as they came.

    Parameters
    ----------
    heading : str
    names : sequence of str             of the columns; the first column holds names
    cells : list of lists of str        rows
    below : str                         a caption
    total : bool                        the last row stands apart

    Attributes
    ----------
    heading, names, cells, below        as given
    """

    def __init__(
        self,
        heading: str,
        names: Sequence[str],
        cells: list[list[str]],
        below: str,
        *,
        total: bool = False,
    ) -> None:
        super().__init__(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        self.heading, self.names, self.cells, self.below = heading, list(names), cells, below
        self.total = total
        for k, name in enumerate(names):
            self.add_column(
                escape(name), justify="left" if self._has_words(k) else "right", overflow="fold"
            )
        for k, row in enumerate(cells):
            if total and k == len(cells) - 1:
                self.add_section()
            self.add_row(*map(escape, row))

    def _has_words(self, column: int) -> bool:
        return column == 0 or any(_WORD.match(row[column]) for row in self.cells)

    def _min_width(self, column: int) -> int:
        """Width that breaks no number, no word, and no name of usual length."""
        cells = [row[column] for row in self.cells]
        head = min(_HEADING_WIDTH, _longest(self.names[column].split()))
        longest_cell = _longest(cells)
        if column == 0:
            return max(head, min(longest_cell, _NAMES_WIDTH))
        if not self._has_words(column):
            return max(head, longest_cell)
        longest_word = _longest(word for cell in cells for word in cell.split())
        return max(head, longest_word, min(longest_cell, _WORDS_WIDTH))

    def _widths(self, room: int) -> list[int]:
        """Widths of the columns: the least, then as far as there is room whole cells, whole words
        in the headings, whole headings."""
        indices = range(len(self.names))
        widths = [self._min_width(k) for k in indices]
        while sum(widths) > max(room, len(widths)):
            # Words and names are broken sooner than numbers.
            widest = max(indices, key=lambda k: (self._has_words(k) and widths[k] > 1, widths[k]))
            widths[widest] -= 1
        for wanted in (
            [_longest(row[k] for row in self.cells) for k in indices],
            [_longest(name.split()) for name in self.names],
            [len(name) for name in self.names],
        ):
            for k in sorted(indices, key=lambda k: wanted[k] - widths[k]):
                widths[k] += max(min(wanted[k] - widths[k], room - sum(widths)), 0)
        return widths

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Any]:
        """The table, or as many as it takes for each to be no wider than the terminal."""
        parts = self._parts(options.max_width)
        # Above and below a narrow table there is more room than in it.
        if self.heading:
            yield Text(self.heading, style="table.title")
        if len(parts) == 1:
            room = options.max_width - _FRAME_WIDTH - _COLUMN_PADDING * len(self.names)
            for column, width in zip(self.columns, self._widths(room), strict=True):
                column.width = width
            yield from super().__rich_console__(console, options)
        else:
            for part in parts:
                shown = [0, *part]
                cells = [[row[k] for k in shown] for row in self.cells]
                names = [self.names[k] for k in shown]
                yield ShownTable("", names, cells, "", total=self.total)
        if self.below:
            yield Text(self.below, style="table.caption")

    def _parts(self, width: int) -> list[list[int]]:
        """Columns beside that of the names, as many at a time as have room, in even parts."""
        needed = [self._min_width(k) + _COLUMN_PADDING for k in range(len(self.names))]
        room = max(width - _FRAME_WIDTH - needed[0], 1)
        indices = range(1, len(self.names))
        parts = _split_columns(indices, needed, room)
        # The least room that takes no more parts spreads the columns evenly.
        while len(parts) > 1 and room > max(needed[1:]):
            tighter = _split_columns(indices, needed, room - 1)
            if len(tighter) > len(parts):
                break
            parts, room = tighter, room - 1
        return parts


def _longest(words: Iterable[str]) -> int:
    """Characters of the longest."""
    return max(map(len, words), default=0)


def _split_columns(columns: Sequence[int], needed: Sequence[int], room: int) -> list[list[int]]:
    """Columns in parts, each filled as far as there is room."""
    parts, used = [list[int]()], 0
    for k in columns:
        if parts[-1] and used + needed[k] > room:
            parts.append([])
            used = 0
        parts[-1].append(k)
        used += needed[k]
    return parts
