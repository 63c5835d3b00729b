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
    text = mode == b"0"
    take = _reader(section, text=text)
    if version.startswith(b"2"):
        # In a binary file the count is text, and meshio takes only 1, 2, 3 ... for numbers.
        blocks = _numbers_of_version_2(take) if text else iter(())
    else:
        blocks = _numbers_of_version_4(take, listed=not version.startswith(b"4.0"))
    for numbers in blocks:
        if (highest := numbers.max(initial=0)) > _HIGHEST:
            raise ValueError(
                f"a node has the number {highest:.0f}, at most {_HIGHEST} is read: number them anew"
            )


def _reader(section: bytes, *, text: bool) -> Take:
    """Takes one value after another from the numbers of a text, or from bytes."""
    values = np.frombuffer(section, np.uint8)
    if text:
        values = np.array(section.partition(b"$EndNodes")[0].split(), dtype=np.float64)
    place = 0

    def take(kind: str, count: int) -> np.ndarray:
        nonlocal place
        start, place = place, place + count * (1 if text else np.dtype(kind).itemsize)
        if not start <= place <= len(values):
            raise ValueError("it has fewer nodes than it declares")
        return values[start:place] if text else values[start:place].view(kind)

    return take


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
            for _ in range(count):
                yield take("i4", 1)
                take("f8", 3)
    if found != said:
        raise ValueError(f"it says that it has {said} nodes, and holds {found}")
