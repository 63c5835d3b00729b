"""Checks of vertex indices in mesh files: integers, in range, and none missing.

The readers of other packages round 1.5, take index 0 for the last vertex where indices start at 1,
and ignore missing entries of a row.
"""

from collections.abc import Iterator
from itertools import islice

import numpy as np
from jaxtyping import Int

_CORNERS = (b"vertex_indices", b"vertex_index")


def whole_numbers(values: np.ndarray) -> Int[np.ndarray, "..."]:
    """Indices as integers.

    Parameters
    ----------
    values : array of numbers

    Returns
    -------
    int array                       of the same shape

    Raises
    ------
    ValueError                      one is not an integer
    """
    if values.dtype.kind == "f":
        wrong = values[~np.isfinite(values) | (values % 1 != 0)]
        if wrong.size:
            raise ValueError(f"a face names vertex {wrong[0]:g}; must be a whole number")
    return values.astype(np.int64)


def check_text_ply(content: bytes) -> None:
    """Refuse a text PLY file with rows that do not match its header.

    Parameters
    ----------
    content : bytes                 the whole file

    Raises
    ------
    ValueError                      the message names the line

    Source
    ------
    Turk, "The PLY polygon file format" (1994).
    """
    head, _, rest = content.partition(b"end_header")
    elements: list[tuple[bytes, int, list[list[bytes]]]] = []
    for line in head.splitlines():
        word, *words = line.split() or [b""]
        if word == b"element":
            elements.append((words[0], int(words[1]), []))
        elif word == b"property" and elements:
            elements[-1][2].append(words)
    rows = _rows(rest, first=head.count(b"\n") + 1)
    for name, count, properties in elements:
        for number, words in islice(rows, count):
            place = 0
            for kind, *more in properties:
                place += 1
                if kind == b"list":
                    held = _whole(number, words[place - 1 : place])
                    if more[-1] in _CORNERS:
                        _check_face(number, words[place : place + held], held)
                    place += held
            if place != len(words) or any(b"_" in word for word in words):
                text = b" ".join(words).decode(errors="replace")[:40]
                raise ValueError(f"line {number}: '{text}' is no row of {name.decode()}")


def check_text_msh(content: bytes) -> None:
    """Refuse a text MSH file with cells whose node numbers are not integers from 1.

    Parameters
    ----------
    content : bytes                 the whole file, version 2 or 4; a binary one passes

    Raises
    ------
    ValueError                      the message names the line

    Source
    ------
    Gmsh reference manual, "MSH file format".
    """
    version, binary, *_ = content.partition(b"$MeshFormat")[2].split(maxsplit=3)
    if binary != b"0":
        return
    before, _, rest = content.partition(b"$Elements")
    rows = _rows(rest.partition(b"$EndElements")[0], first=before.count(b"\n") + 1)
    next(rows)
    blocks = version.startswith(b"4")
    left = 0
    for number, words in rows:
        if blocks and not left:
            left = _whole(number, words[3:4])
            continue
        left -= 1
        known = 1 if blocks else 3 + _whole(number, words[2:3])
        for word in words[known:]:
            if _whole(number, [word]) < 1:
                raise ValueError(f"line {number}: a cell has node {word.decode()}; counted from 1")


def _rows(content: bytes, *, first: int) -> Iterator[tuple[int, list[bytes]]]:
    """Number and words of every line that is not blank; the number of the first one is given."""
    for number, line in enumerate(content.split(b"\n"), start=first):
        if words := line.split():
            yield number, words


def _check_face(number: int, corners: list[bytes], count: int) -> None:
    """Refuse a face with fewer than three corners, or fewer than it declares."""
    for corner in corners:
        _whole(number, [corner])
    if count < 3 or len(corners) < count:
        raise ValueError(f"line {number}: the face says {count} corners, and has {len(corners)}")


def _whole(number: int, words: list[bytes]) -> int:
    """The first of some words as an integer."""
    text = words[0].decode(errors="replace") if words else ""
    if not text.removeprefix("-").isdecimal():
        raise ValueError(f"line {number}: '{text[:40]}' is no whole number")
    return int(text)
