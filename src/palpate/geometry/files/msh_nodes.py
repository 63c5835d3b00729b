"""Check of the numbers of nodes in MSH files.

Meshio's reader makes a table with an entry for every number up to the highest: where a file is
damaged, that fills the memory.
"""

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Shaped

# Far above the number of nodes of any mesh that is read; the table then takes 160 MB.
_HIGHEST = 20_000_000

# Takes so many values of a type from the file, from where the last call ended.
Take = Callable[[str, int], np.ndarray]


def check_msh_nodes(content: bytes) -> None:
    """Refuse an MSH file with implausible numbers of nodes, or fewer nodes than it declares.

    Parameters
    ----------
    content : bytes                 the whole file, version 2 or 4, text or binary

    Raises
    ------
    ValueError                      the message names the number

    Source
    ------
    Gmsh reference manual, "MSH file format".
    """
    version, mode, *_ = content.partition(b"$MeshFormat")[2].split(maxsplit=2)
    section = content.partition(b"$Nodes")[2].partition(b"\n")[2]
    take = _take_text(section) if mode == b"0" else _take_binary(section)
    if version.startswith(b"2"):
        # In a binary file the count is text, and meshio takes only 1, 2, 3 ... for numbers.
        blocks = _numbers_of_version_2(take) if mode == b"0" else iter(())
    else:
        blocks = _numbers_of_version_4(take, listed=not version.startswith(b"4.0"))
    for numbers in blocks:
        if (highest := numbers.max(initial=0)) > _HIGHEST:
            raise ValueError(
                f"a node has the number {highest:.0f}, at most {_HIGHEST} is read: number them anew"
            )


def _take_text(section: bytes) -> Take:
    values = np.array(section.partition(b"$EndNodes")[0].split(), dtype=np.float64)
    place = 0

    def take(_: str, count: int) -> np.ndarray:
        nonlocal place
        start, place = place, place + count
        _check_end(start, place, len(values))
        return values[start:place]

    return take


def _take_binary(section: bytes) -> Take:
    place = 0

    def take(kind: str, count: int) -> np.ndarray:
        nonlocal place
        start, place = place, place + count * np.dtype(kind).itemsize
        _check_end(start, place, len(section))
        return np.frombuffer(section[start:place], kind)

    return take


def _check_end(start: int, place: int, end: int) -> None:
    if not start <= place <= end:
        raise ValueError("it has fewer nodes than it declares")


def _numbers_of_version_2(take: Take) -> Iterator[Shaped[np.ndarray, " n"]]:
    """Rows of number, x, y, z."""
    count = int(take("i4", 1)[0])
    yield take("f8", 4 * count)[::4]


def _numbers_of_version_4(take: Take, *, listed: bool) -> Iterator[Shaped[np.ndarray, " n"]]:
    """Blocks of nodes; their numbers come first, or (4.0) with their coordinates."""
    blocks, said = map(int, take("u8", 2))
    found = 0
    if listed:
        take("u8", 2)
    for _ in range(blocks):
        take("i4", 3)
        count = int(take("u8", 1)[0])
        found += count
        if listed:
            yield take("u8", count)
            take("f8", 3 * count)
        else:
            yield from (_row(take)[:1] for _ in range(count))
    if found != said:
        raise ValueError(f"it says that it has {said} nodes, and holds {found}")


def _row(take: Take) -> Shaped[np.ndarray, " n"]:
    """Number and coordinates of one node."""
    number = take("i4", 1)
    take("f8", 3)
    return number
