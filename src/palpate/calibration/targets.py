"""Calibration targets: positions of their marks, and detection of the marks in a picture."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from palpate.errors import InputError
from palpate.shapes import Points

Grey = UInt8[np.ndarray, "rows columns"]
# Half side of the window for refining a corner: fraction of the free distance to other corners, and
# limits [px].
_FREE_FRACTION, _MIN_WINDOW_PX, _MAX_WINDOW_PX = 0.9, 2, 11
# Larger pictures are searched at reduced size, and the corners refined at full size.
_MAX_SEARCHED_PX = 1600
# Largest number of marks in each direction.
_MAX_MARKS = 1000
# A marker whose bits a camera could tell apart, as a fraction of its square.
_LEAST_MARKER = 0.2
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
DICTIONARIES = {
    name.removeprefix("DICT_").lower(): getattr(cv2.aruco, name)
    for name in dir(cv2.aruco)
    if name.startswith("DICT_")
}


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """Marks of a target found in a picture.

    Attributes
    ----------
    mark : (k,) int                 their numbers on the target
    pixel : (k, 2) float [px]       column and row; the centre of the first pixel is (0, 0)
    """

    mark: Int[np.ndarray, " k"]
    pixel: Float[np.ndarray, "k 2"]


@runtime_checkable
class Target(Protocol):
    """A flat pattern whose marks can be detected in a picture."""

    @property
    def points(self) -> Points:
        """Position of every mark in the target's frame, z = 0, (n, 3) float [m]."""

    @property
    def turned(self) -> Int[np.ndarray, " n"] | None:
        """Numbers of the marks after half a turn, if the target then looks the same; else None."""

    def find(self, picture: Grey) -> Sighting:
        """Detect the marks in a picture; the sighting is empty if the target is not found.

        Parameters
        ----------
        picture : (rows, columns) uint8

        Returns
        -------
        Sighting
        """


def _check_grid(columns: int, rows: int, spacing: float, *, minimum: int = 2) -> None:
    if min(columns, rows) < minimum or max(columns, rows) > _MAX_MARKS or not spacing > 0.0:
        raise InputError(
            f"a target of {columns} x {rows} marks {spacing:g} m apart; must have {minimum} to"
            f" {_MAX_MARKS} each way, at a distance above 0"
        )


def _grid(columns: int, rows: int, spacing: float) -> Points:
    """Points of a grid, row by row, (columns * rows, 3)."""
    cell = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    return spacing * np.column_stack([cell, np.zeros(len(cell))])


@dataclass(frozen=True, slots=True)
class Chessboard:
    """A chessboard; its marks are the inner corners.

    Parameters
    ----------
    columns, rows : int             inner corners, one less than squares
    square : float [m]              side of a square

    Raises
    ------
    InputError                      fewer than 3 or more than 1000 corners in a direction, or a side
                                    that is not positive
    """

    columns: int
    rows: int
    square: float

    def __post_init__(self) -> None:
        # OpenCV's detector needs at least three.
        _check_grid(self.columns, self.rows, self.square, minimum=3)

    @property
    def points(self) -> Points:
        """See `Target`."""
        return _grid(self.columns, self.rows, self.square)

    @property
    def turned(self) -> Int[np.ndarray, " n"] | None:
        """See `Target`; here the marks always count as looking the same after half a turn."""
        return np.arange(self.columns * self.rows)[::-1].copy()

    def find(self, picture: Grey) -> Sighting:
        """See `Target`; all corners or none."""
        small, scale = _shrunk(picture)
        size, flags = (self.columns, self.rows), cv2.CALIB_CB_NORMALIZE_IMAGE
        complete, pixel = cv2.findChessboardCornersSB(small, size, flags=flags)
        if not complete:
            flags |= cv2.CALIB_CB_EXHAUSTIVE
            complete, pixel = cv2.findChessboardCornersSB(small, size, flags=flags)
        seen = _whole(complete, pixel)
        if len(seen.mark) == 0:
            return seen
        # The detector is accurate to 1/3 px, the saddle point of the grey levels to 1/30 px.
        coarse = scale * (seen.pixel + 0.5) - 0.5
        return Sighting(seen.mark, _refined(picture, coarse, self.points, 0.5 * self.square))


@dataclass(frozen=True, slots=True)
class Circles:
    """A grid of dark circles on white; its marks are their centres.

    Parameters
    ----------
    columns, rows : int             circles in a row, and rows
    spacing : float [m]             between centres; in an asymmetric grid, between rows, which is
                                    half the distance of neighbours in a row
    asymmetric : bool               every other row is shifted by `spacing`

    Raises
    ------
    InputError                      fewer than 2 or more than 1000 circles in a direction, or a
                                    spacing that is not positive
    """

    columns: int
    rows: int
    spacing: float
    asymmetric: bool = False

    def __post_init__(self) -> None:
        _check_grid(self.columns, self.rows, self.spacing)

    @property
    def points(self) -> Points:
        """See `Target`."""
        grid = _grid(self.columns, self.rows, self.spacing)
        if self.asymmetric:
            row = np.rint(grid[:, 1] / self.spacing)
            grid[:, 0] = 2.0 * grid[:, 0] + self.spacing * (row % 2)
        return grid

    @property
    def turned(self) -> Int[np.ndarray, " n"] | None:
        """See `Target`; None for an asymmetric grid with an odd number of rows."""
        if self.asymmetric and self.rows % 2 == 1:
            return None
        return np.arange(self.columns * self.rows)[::-1].copy()

    def find(self, picture: Grey) -> Sighting:
        """See `Target`; all circles or none."""
        kind = cv2.CALIB_CB_ASYMMETRIC_GRID if self.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
        complete, pixel = cv2.findCirclesGrid(picture, (self.columns, self.rows), flags=kind)
        seen = _whole(complete, pixel)
        if not (self.asymmetric and self.rows % 2 == 0 and len(seen.mark)):
            return seen
        # With an even number of rows, OpenCV swaps them in pairs: second, first, fourth, third, ...
        pairs = seen.pixel.reshape(-1, 2, self.columns, 2)
        return Sighting(seen.mark, np.ascontiguousarray(pairs[:, ::-1]).reshape(-1, 2))


@dataclass(frozen=True, slots=True)
class Charuco:
    """A ChArUco board: a chessboard with a marker in every white square; may be partly hidden.

    Parameters
    ----------
    columns, rows : int             squares, at least 3 in each direction
    square, marker : float [m]      sides, 0 < marker < square
    dictionary : str                of the markers, one of `DICTIONARIES`
    first : int                     number of its first marker; boards used together must differ

    Raises
    ------
    InputError                      a number or side out of range, an unknown dictionary, or one
                                    with too few markers
    """

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str = "4x4_250"
    first: int = 0

    def __post_init__(self) -> None:
        small = _LEAST_MARKER * self.square
        if not 0.0 < small <= self.marker < self.square or min(self.columns, self.rows) < 3:
            raise InputError(
                f"a board of {self.columns} x {self.rows} squares of {1e3 * self.square:g} mm with"
                f" markers of {1e3 * self.marker:g} mm; must have 3 x 3 squares or more, and"
                " markers smaller than the squares, but no less than a fifth"
            )
        _check_numbers(self.first, self.columns * self.rows // 2, self.dictionary)

    @property
    def points(self) -> Points:
        """See `Target`."""
        return np.asarray(self._board().getChessboardCorners(), dtype=np.float64)

    @property
    def turned(self) -> Int[np.ndarray, " n"] | None:
        """See `Target`; None, because the markers define the orientation."""
        return None

    def find(self, picture: Grey) -> Sighting:
        """See `Target`."""
        # One marker beside a corner is enough: at the edge of the picture, which constrains the
        # distortion most, the other may be cut off.
        ask = cv2.aruco.CharucoParameters()
        ask.minMarkers = 1
        corners, ids, _, _ = cv2.aruco.CharucoDetector(self._board(), ask).detectBoard(picture)
        if ids is None or len(ids) < 4:
            return _NOTHING
        mark = ids.ravel().astype(np.int64)
        free = 0.5 * (self.square - self.marker)
        return Sighting(mark, _refined(picture, corners.reshape(-1, 2), self.points[mark], free))

    def drawing(self, pixels_per_square: int) -> Grey:
        """Picture of the board for printing.

        Parameters
        ----------
        pixels_per_square : int

        Returns
        -------
        (rows, columns) uint8       without a margin
        """
        size = (self.columns * pixels_per_square, self.rows * pixels_per_square)
        return np.asarray(self._board().generateImage(size))

    def _board(self) -> cv2.aruco.CharucoBoard:
        dictionary = _dictionary(self.dictionary)
        ids = self.first + np.arange(self.columns * self.rows // 2)
        size = (self.columns, self.rows)
        return cv2.aruco.CharucoBoard(size, self.square, self.marker, dictionary, ids)


@dataclass(frozen=True, slots=True)
class AprilGrid:
    """A grid of AprilTags or ArUco markers; its marks are the four corners of each.

    Parameters
    ----------
    columns, rows : int             tags, at least 1 in each direction
    tag, gap : float [m]            side of a tag, and white gap between two tags; > 0
    dictionary : str                one of `DICTIONARIES`
    first : int                     number of the first tag

    Raises
    ------
    InputError                      a number or length out of range, an unknown dictionary, or one
                                    with too few tags
    """

    columns: int
    rows: int
    tag: float
    gap: float
    dictionary: str = "apriltag_36h11"
    first: int = 0

    def __post_init__(self) -> None:
        if not min(self.tag, self.gap) > 0.0 or min(self.columns, self.rows) < 1:
            raise InputError(
                f"a grid of {self.columns} x {self.rows} tags of {1e3 * self.tag:g} mm with"
                f" {1e3 * self.gap:g} mm between them; must have one or more each way, and lengths"
                " above 0"
            )
        _check_numbers(self.first, self.columns * self.rows, self.dictionary)

    @property
    def points(self) -> Points:
        """See `Target`; tag by tag, clockwise from each tag's first corner."""
        corner = _grid(self.columns, self.rows, self.tag + self.gap)
        square = self.tag * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        return (corner[:, None] + square).reshape(-1, 3)

    @property
    def turned(self) -> Int[np.ndarray, " n"] | None:
        """See `Target`; None, because the tags define the orientation."""
        return None

    def find(self, picture: Grey) -> Sighting:
        """See `Target`."""
        detector = cv2.aruco.ArucoDetector(_dictionary(self.dictionary))
        corners, ids, _ = detector.detectMarkers(picture)
        if ids is None:
            return _NOTHING
        number = ids.ravel().astype(np.int64) - self.first
        known = (number >= 0) & (number < self.columns * self.rows)
        if not known.any():
            return _NOTHING
        pixel = np.stack(corners).reshape(-1, 4, 2)[known].reshape(-1, 2).astype(np.float64)
        mark = (4 * number[known, None] + np.arange(4)).ravel()
        # The border of a tag is as wide as one of its eight modules.
        free = 0.75 * min(self.gap, self.tag / 8.0)
        return Sighting(mark, _refined(picture, pixel, self.points[mark], free))


# Kinds of target, with the name of the second length that some have.
TARGET_KINDS = {
    "charuco": "marker",
    "chessboard": None,
    "circles": None,
    "asymmetric-circles": None,
    "aprilgrid": "gap",
}


def make_target(
    kind: str, columns: int, rows: int, side: float, second: float | None, dictionary: str | None
) -> Target:
    """A target of a kind.

    Parameters
    ----------
    kind : str                      a key of `TARGET_KINDS`
    columns, rows : int             as its class counts them
    side : float [m]                of a square or tag; spacing of circles
    second : float [m] or None      the length that `TARGET_KINDS` names
    dictionary : str or None        of the markers; None: the usual one

    Returns
    -------
    Target

    Raises
    ------
    InputError                      as its class
    """
    if kind == "chessboard":
        return Chessboard(columns, rows, side)
    if kind in ("circles", "asymmetric-circles"):
        return Circles(columns, rows, side, kind == "asymmetric-circles")
    if kind == "aprilgrid":
        return AprilGrid(columns, rows, side, second or 0.0, dictionary or "apriltag_36h11")
    return Charuco(columns, rows, side, second or 0.0, dictionary or "4x4_250")


_NOTHING = Sighting(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    if name not in DICTIONARIES:
        raise InputError(f"no dictionary of markers '{name}'; known: {', '.join(DICTIONARIES)}")
    return cv2.aruco.getPredefinedDictionary(DICTIONARIES[name])


def _check_numbers(first: int, count: int, dictionary: str) -> None:
    """Raise if the dictionary does not have the markers."""
    has = len(_dictionary(dictionary).bytesList)
    if first < 0 or first + count > has:
        raise InputError(
            f"the board needs markers {first} to {first + count - 1}; the dictionary {dictionary}"
            f" has 0 to {has - 1}: choose a larger one, or a smaller board"
        )


def _whole(complete: bool, pixel: np.ndarray | None) -> Sighting:
    """Sighting of all marks of a target, or an empty one."""
    if not complete or pixel is None:
        return _NOTHING
    pixel = pixel.reshape(-1, 2).astype(np.float64)
    return Sighting(np.arange(len(pixel)), pixel)


def _shrunk(picture: Grey) -> tuple[Grey, float]:
    """Reduce a picture to a searchable size; also returns the reduction factor (whole number)."""
    scale = max(picture.shape) / _MAX_SEARCHED_PX
    if scale <= 1.0:
        return picture, 1.0
    scale = float(np.ceil(scale))
    rows, columns = (int(size // scale) for size in picture.shape)
    whole = picture[: int(rows * scale), : int(columns * scale)]
    return np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)), scale


def _refined(
    picture: Grey, pixel: Float[np.ndarray, "k 2"], points: Points, free: float
) -> Float[np.ndarray, "k 2"]:
    """Refine corners to sub-pixel accuracy; around each, `free` [m] on the target is empty."""
    # On a tilted board, other corners are nearest in the direction of strongest foreshortening.
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    slope = np.linalg.lstsq(flat, pixel - pixel.mean(axis=0), rcond=None)[0]
    pixels_per_metre = float(np.linalg.svd(slope, compute_uv=False)[-1])
    half = int(np.clip(_FREE_FRACTION * free * pixels_per_metre, _MIN_WINDOW_PX, _MAX_WINDOW_PX))
    start = np.array(pixel, dtype=np.float32, order="C").reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(picture, start, (half, half), (-1, -1), _STOP)
    return refined.reshape(-1, 2).astype(np.float64)
