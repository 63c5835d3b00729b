"""Work of C and C++ libraries on what others made, in a child process with limits.

A damaged file makes such a library crash, hang or ask for all memory, and Mmg takes the signals of
its process: nothing of that reaches the command. The modules below are small, as each child loads
them again. What goes between the processes is pickled: both have the same rights.
"""

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, suppress
from inspect import isgenerator
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from palpate.errors import PalpateError
from palpate.files import reason
from palpate.optional_imports import late_import

try:
    import resource
except ModuleNotFoundError:  # Windows has no such limits
    resource = None  # type: ignore[assignment]

# For one result: a part of thousands of faces takes seconds, a frame of a video milliseconds.
_MOST_SECONDS = 300.0
# Address space [bytes]: a damaged file may ask for any, 16 threads on frames of 8K need half.
_MOST_BYTES = 4 * 2**30
_TOO_MUCH = f"it takes more than {_MOST_BYTES / 1e9:.0f} GB of memory"
# With -P, or modules in the current folder would be run; -I would lose the user's own packages.
_CHILD = "from palpate.foreign import _serve; _serve()"
# Formats of FFmpeg that hold a video; others, such as playlists, name files to open in their place.
_CONTAINERS = "avi,mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,mpegts,mpeg,asf,flv,ogg,mxf,nut"
# Address space that no work needs: heaps and buffers for every processor.
_FRUGAL = {"MALLOC_ARENA_MAX": "2", "OPENBLAS_NUM_THREADS": "1"}


def results_in_child(
    work: Callable[..., Any], *arguments: Any, seconds: float = _MOST_SECONDS
) -> Generator[Any, None, None]:
    """What a function gives that runs in a process of its own: its result, or what it yields.

    Parameters
    ----------
    work : callable                 of a module, not nested; may be a generator
    *arguments                      that can be pickled, like the results
    seconds : float                 longest time for one result

    Yields
    ------
    any

    Raises
    ------
    PalpateError                    raised by the function
    RuntimeError                    in place of any other error of the function, of the end of its
                                    process, of too long a time; the text says which
    """
    child = subprocess.Popen(
        [sys.executable, "-P", "-c", _CHILD],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        env=os.environ | _FRUGAL,
    )  # fmt: skip
    orders, results = cast(IO[bytes], child.stdin), cast(IO[bytes], child.stdout)
    try:
        with suppress(BrokenPipeError), orders:
            pickle.dump((work, arguments, seconds), orders)
        while True:
            try:
                result, error, more = pickle.load(results)
            except (EOFError, pickle.UnpicklingError):
                late = child.wait() == -signal.SIGALRM
                slow, broken = f"it takes more than {seconds:g} s", f"a crash, or {_TOO_MUCH}"
                raise RuntimeError(slow if late else broken) from None
            if error is not None:
                raise error
            if not more:
                return
            yield result
    finally:
        child.kill()
        child.wait()
        results.close()


def result_in_child(
    work: Callable[..., Any], *arguments: Any, seconds: float = _MOST_SECONDS
) -> Any:
    """The only result of `results_in_child`."""
    with closing(results_in_child(work, *arguments, seconds=seconds)) as results:
        return next(results)


def _serve() -> None:
    """Run what standard input orders, within the limits; results go where standard output led."""
    results = os.fdopen(os.dup(1), "wb")
    # Libraries print, too.
    os.dup2(2, 1)
    # Other systems refuse the limit, or do not know it.
    if sys.platform == "linux":
        limits = [n for n in resource.getrlimit(resource.RLIMIT_AS) if n != resource.RLIM_INFINITY]
        most = min(_MOST_BYTES, *limits) if limits else _MOST_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (most, limits[-1] if limits else -1))
    error: Exception | None = None
    try:
        work, arguments, seconds = pickle.load(sys.stdin.buffer)
        # The system ends this process in time, in the midst of a library too, and where the command
        # that waited for it was killed.
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, seconds)
        made = work(*arguments)
        for result in made if isgenerator(made) else [made]:
            # Whoever reads may take his time.
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            pickle.dump((result, None, True), results, protocol=5)
            results.flush()
            signal.setitimer(signal.ITIMER_REAL, seconds)
    except PalpateError as raised:
        error = raised
    except MemoryError:
        error = RuntimeError(_TOO_MUCH)
    # Libraries raise errors of any class, some of which cannot be pickled.
    except (Exception, SystemExit) as raised:  # noqa: BLE001
        error = RuntimeError(reason(raised))
    pickle.dump((None, error, False), results)
    results.flush()


def triangles_of_step(source: Path, target: Path, deviation: float, angle: float) -> bool:
    """Triangulate the solids of a STEP file with OpenCASCADE, into a GLB file.

    Parameters
    ----------
    source, target : Path
    deviation : float               of the triangles from the surface, relative to its edges
    angle : float [rad]             between adjacent triangles

    Returns
    -------
    bool                            whether there was a solid
    """
    cad = late_import("cascadio", extra="cad", purpose=f"reading {source.name}")
    done = cad.step_to_glb(str(source), str(target), deviation, angle, tol_relative=True)
    return done == 0 and target.exists()


def read_by_meshio(path: Path, kind: str) -> Any:
    """A mesh file as meshio reads it, whose tables are as long as a damaged file says.

    Parameters
    ----------
    path : Path
    kind : str                      meshio's name of the format

    Returns
    -------
    meshio.Mesh
    """
    meshio = late_import("meshio", extra=None, purpose=f"reading {path.name}")
    # `meshio.read` would end the process without saying what is wrong.
    return getattr(meshio, kind).read(path)


def decoded_video(path: Path) -> Iterator[Any]:
    """The frames of a video, by FFmpeg, up to the first that cannot be decoded.

    Parameters
    ----------
    path : Path

    Yields
    ------
    int                             first of all: the number of frames by the header, 0 if it does
                                    not tell
    float [s], (rows, columns) uint8    for each: time stamp in the file, grey levels

    Raises
    ------
    RuntimeError                    no video
    """
    cv2 = late_import("cv2", extra=None, purpose=f"reading {path.name}")
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = f"format_whitelist;{_CONTAINERS}"
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise RuntimeError(f"it has {path.stat().st_size} bytes")
    yield max(int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
    while True:
        good, picture = capture.read()
        if not good:
            return
        grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        yield capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3, np.asarray(grey)


def scans_of_e57(path: Path) -> tuple[int, np.ndarray]:
    """The number of scans in an E57 file, and the points of the first.

    Parameters
    ----------
    path : Path

    Returns
    -------
    int
    (n, 3) float [m]                in the file's frame, without points marked as invalid; empty
                                    unless there is one scan
    """
    file = late_import("pye57", extra="e57", purpose=f"reading {path.name}").E57(str(path))
    if file.scan_count != 1:
        return file.scan_count, np.zeros((0, 3))
    scan = file.read_scan(0, ignore_missing_fields=True)
    return 1, np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=1)


def remeshed_by_mmg(
    vertices: np.ndarray,
    triangles: np.ndarray,
    size: np.ndarray,
    rim: np.ndarray | None,
    options: dict[str, float],
) -> tuple[np.ndarray, np.ndarray]:
    """A surface with triangles of wanted sizes, by Mmg.

    Parameters
    ----------
    vertices : (v, 3) float [m]
    triangles : (t, 3) int
    size : (v,) float [m]           wanted edge length at each vertex
    rim : (k, 2) int or None        edges that are kept
    options : dict                  passed on to Mmg

    Returns
    -------
    (w, 3) float [m], (u, 3) int    vertices, triangles
    """
    mmg = late_import("mmgpy", extra="surface", purpose="remeshing a surface")
    body = mmg.MmgMeshS(vertices, triangles.astype(np.int32))
    body["metric"] = np.ascontiguousarray(size[:, None])
    if rim is not None:
        body.set_mesh_size(vertices=len(vertices), triangles=len(triangles), edges=len(rim))
        body.set_vertices(vertices)
        body.set_triangles(triangles.astype(np.int32))
        body.set_edges(rim.astype(np.int32))
        body.set_ridge_edges(np.arange(len(rim), dtype=np.int32))
    body.remesh(verbose=-1, **options)
    return np.array(body.get_vertices()), np.array(body.get_triangles(), dtype=np.int64)
