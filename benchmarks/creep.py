"""Does the modulus over time come out: terms, times, intervals, also under a ball; and how fast.

`python -m benchmarks.creep [DRAWS]` prints all of it, with 200 draws in some five minutes. A
body is solved once by the static model, and what it moves is multiplied by c(t) of a compliance
that is known; noise is drawn anew in every repeat.
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from palpate.geometry import TriangleMesh, write_mesh
from palpate.pipeline import (
    fit_session,
    graded_session,
    make_object_model,
    poke_session,
    refined_session,
    session_observations,
)
from palpate.records import Session, read_session
from palpate.relaxation import CreepCompliance, Motion, fit_creep

SHEAR, NU = 2e4, 0.3
PRESS = np.array([0.1, 0.0, -1.2])
ELASTIC = CreepCompliance(1.0, np.zeros(0), np.zeros(0))
ONE = CreepCompliance(1.0, np.array([0.4]), np.array([8.0]))
TWO = CreepCompliance(1.0, np.array([0.3, 0.5]), np.array([3.0, 60.0]))
TRUTHS = {"elastic": ELASTIC, "one term": ONE, "two terms": TWO}
RISE, HOLD, INSTANTS = 0.5, 300.0, 300
AT = np.array([1.0, 10.0, 100.0])
_SESSION = """\
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "m"
[support]
plane = {{ point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-6 }}
[[probe]]
name = "n01"
contact = {{ point = [0.02, 0.02, 0.04], radius = 0.006, profile = "smooth" }}
force = [{}, {}, {}]
displacement = "n01.csv"
"""
_SERIES = 'series = "n01_series.csv"\n'


def pressed() -> tuple[np.ndarray, np.ndarray]:
    """Times and forces over the largest of a push that is held, (INSTANTS + 20,)."""
    rising = np.linspace(0.0, RISE, 21)
    times = np.append(rising, RISE + np.geomspace(0.05, HOLD, INSTANTS - 1))
    return times, np.minimum(times / RISE, 1.0)


def cube() -> TriangleMesh:
    """A cube of 40 mm, 6 by 6 squares on each face."""
    from_tests = np.linspace(0.0, 0.04, 7)
    grid = np.stack(np.meshgrid(from_tests, from_tests, indexing="ij"), axis=-1).reshape(-1, 2)
    index = np.arange(49).reshape(7, 7)
    a, b, c, d = (index[i : i + 6, j : j + 6].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    flat = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    vertices: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    for axis in range(3):
        for side in (0.0, 0.04):
            points = np.full((49, 3), side)
            points[:, [(axis + 1) % 3, (axis + 2) % 3]] = grid
            triangles.append((flat if side else flat[:, ::-1]) + 49 * len(vertices))
            vertices.append(points)
    every, number = np.unique(np.round(np.concatenate(vertices), 9), axis=0, return_inverse=True)
    return TriangleMesh(every, number.ravel()[np.concatenate(triangles)])


def write_creeping_session(
    folder: Path, truth: CreepCompliance, *, noise: float = 0.0, seed: int = 0,
    instants: Sequence[int] | None = None, drift: float = 0.0, gain: float = 1.0,
) -> Path:  # fmt: skip
    """A session of a cube that creeps: frames of its upper half, and the force that presses it.

    Parameters
    ----------
    folder : Path                   made here
    truth : CreepCompliance         over 1 / SHEAR
    noise : float                   of every component, over the largest displacement
    seed : int
    instants : numbers or None      that have frames; None: all from the contact on; empty: static
    drift : float                   change of Poisson's ratio over the hold
    gain : float                    force of the session over the true one
    """
    folder.mkdir()
    rng, mesh = np.random.default_rng(seed), cube()
    write_mesh(folder / "mesh.ply", mesh)
    points = mesh.vertices[mesh.vertices[:, 2] > 0.015]
    text = _SESSION.format(*(gain * PRESS))
    (folder / "session.toml").write_text(text)
    _write_field(folder / "n01.csv", points, -1e-4 * np.ones_like(points), 1e-5)
    graded = graded_session(refined_session(read_session(folder)))
    observed = session_observations(graded, make_object_model(graded))[0]
    shapes = [
        (observed.response.value(nu) @ np.append(PRESS, 0.0) / SHEAR).reshape(-1, 3)
        for nu in (NU, NU + 0.01)
    ]
    times, force = pressed()
    moved, std = truth.response(times, force), noise * float(np.abs(shapes[0]).max())
    turn = 100.0 * drift * np.log(np.maximum(times, RISE) / RISE) / np.log(times[-1] / RISE)

    def frame(k: int) -> np.ndarray:
        shape = shapes[0] + turn[k] * (shapes[1] - shapes[0])
        return moved[k] * shape + std * rng.standard_normal(shape.shape)

    _write_field(folder / "n01.csv", points, frame(len(times) - 1), std or 1e-9)
    seen = range(1, len(times)) if instants is None else instants
    rows = ["t,fx,fy,fz,displacement"]
    for k, (at, share) in enumerate(zip(times, force, strict=True)):
        name = f"frame{k}.csv" if k in seen else ""
        if name:
            _write_field(folder / name, points, frame(k), std or 1e-9)
        rows.append(",".join([*map(repr, [float(at), *(gain * share * PRESS).tolist()]), name]))
    if len(seen):
        (folder / "n01_series.csv").write_text("\n".join([*rows, ""]))
        (folder / "session.toml").write_text(text + _SERIES)
    return folder


def _write_field(path: Path, points: np.ndarray, moved: np.ndarray, std: float) -> None:
    rows = np.hstack([points, moved, np.full((len(points), 1), std)])
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header="x,y,z,ux,uy,uz,sigma", comments="")


def draws(
    truth: CreepCompliance, *, noise: float, count: int, correlation: float = 0.0, every: int = 1
) -> dict:
    """Fits of the amplitudes alone, `count` times: terms found, errors of the logarithm of G at AT
    (that of the static instant is exact), whether the intervals hold them, errors of the times."""
    times, force = pressed()
    moved = truth.response(times, force) / truth.response(times, force)[-1]
    instant, last = np.arange(1, len(times), every), len(times) - 1
    modulus, unit = truth.relaxation(), truth.response(times, force)[-1]
    true = np.log(np.append(modulus.at(AT), [modulus.instantaneous, modulus.long_term]) * unit)
    result: dict = {"terms": Counter(), "error": [], "hold": [], "times": []}
    for seed in range(count):
        rng = np.random.default_rng(seed)
        white = rng.standard_normal(len(times))
        for k in range(1, len(times)):
            white[k] = correlation * white[k - 1] + np.sqrt(1 - correlation**2) * white[k]
        measured = (moved + noise * white)[instant]
        std = np.full(len(instant), noise)
        motion = Motion(times, force, instant, measured, std, last)
        fitted = fit_creep([motion], shortest=RISE, longest=HOLD / 3.0)
        value, width = fitted.logarithm(_quantities)
        result["terms"][fitted.terms] += 1
        result["error"].append(value - true)
        result["hold"].append(np.abs(value - true) <= fitted.quantile * width)
        if fitted.terms == len(truth.times):
            apart = np.log(fitted.compliance.times) - np.log(truth.times)
            result["times"].append(np.abs(np.expm1(apart)))
    return result


def _quantities(compliance: CreepCompliance) -> np.ndarray:
    modulus = compliance.relaxation()
    return np.append(modulus.at(AT), [modulus.instantaneous, modulus.long_term])


def ball(
    far: float, *, tip: bool = False, linear: bool = False, free_radius: bool = False
) -> np.ndarray:
    """Errors of the logarithm of G at AT of a ball pressed into a half space that creeps, without
    noise, seen at points farther than `far` of its largest contact radii, with the radius of every
    instant free or as it was at the end, or at its tip.

    Lee and Radok: while the contact grows, a^3 = 3/8 R (1 - nu) int J dF, and the surface is that
    of the elastic contact of that radius a.
    """
    times, force = pressed()
    moved = by_quadrature(TWO, times, force)
    radius = np.cbrt(moved / moved[-1])
    if tip:
        amplitude = radius**2 if linear else radius**3
    else:
        r = np.linspace(far, 10.0, 60)
        shapes = np.stack([_outside(r, max(a, 1e-9)) for a in radius])
        root = np.sqrt(r)  # as many points in each ring as its length
        columns = [shapes[-1]]
        if free_radius:
            step = 1e-4
            wide, narrow = (_outside(r, a) / a**3 for a in (1.0 + step, 1.0 - step))
            columns.append((wide - narrow) / (2.0 * step))
        design = np.stack(columns, axis=1) * root[:, None]
        amplitude = np.linalg.lstsq(design, (shapes * root).T)[0][0]
    instant, last = np.arange(1, len(times)), len(times) - 1
    motion = Motion(times, force, instant, amplitude[1:], np.full(last, 1e-3), last)
    fitted = fit_creep([motion], shortest=RISE, longest=HOLD / 3.0)
    true = TWO.relaxation().at(AT) * moved[-1]
    return np.log(fitted.compliance.relaxation().at(AT) / true)


def _outside(r: np.ndarray, a: float) -> np.ndarray:
    """Displacement of the surface of a half space under a ball, times pi times its radius, at
    distances r beyond the contact radius a (Johnson 1985, eq. 3.42a)."""
    s = np.minimum(a / r, 1.0)
    return (2.0 * a**2 - r**2) * np.arcsin(s) + r * a * np.sqrt(1.0 - s**2)


def ball_on_cube() -> np.ndarray:
    """Errors of the logarithm of G at AT of a cube of two terms under a ball of 20 mm, from a whole
    fit, with noise of 0.1 % of the largest motion.

    While the contact grows, the body is at every time the elastic one of modulus SHEAR / c(t): its
    contact is computed at eleven such moduli, and what it moves there, in between by splines.
    """
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mesh = cube()
        write_mesh(folder / "mesh.ply", mesh)
        points = mesh.vertices[mesh.vertices[:, 2] > 0.015]
        tool = 'tool = "sphere", tool_radius = 0.02'
        text = _SESSION.format(*PRESS).replace('radius = 0.006, profile = "smooth"', tool)
        (folder / "session.toml").write_text(text)
        _write_field(folder / "n01.csv", points, -1e-4 * np.ones_like(points), 1e-5)
        field = CubicSpline(*_under_a_ball(read_session(folder)))
        times, force = pressed()
        moved = field(TWO.response(times, force))
        noise = 0.001 * float(np.abs(moved).max())
        moved += noise * rng.standard_normal(moved.shape)
        rows = ["t,fx,fy,fz,displacement"]
        for k, (at, share) in enumerate(zip(times, force, strict=True)):
            frame = f"{k}.csv" if k % 8 == 1 else ""
            if frame:
                _write_field(folder / frame, points, moved[k], noise)
            rows.append(",".join([*map(repr, [float(at), *(share * PRESS).tolist()]), frame]))
        _write_field(folder / "n01.csv", points, moved[-1], noise)
        (folder / "n01_series.csv").write_text("\n".join([*rows, ""]))
        (folder / "session.toml").write_text(text + _SERIES)
        relaxation = fit_session(read_session(folder)).estimate.relaxation
    at = [
        point.modulus.value
        for point in relaxation.curve
        if min(abs(np.log(point.time / AT))) < 1e-6
    ]
    return np.log(np.array(at) / (SHEAR * TWO.relaxation().at(AT)))


def _under_a_ball(session: Session) -> tuple[np.ndarray, np.ndarray]:
    """What the points of its probing move by, at some values of c(t)."""
    levels = np.array([0.0, 1e-3, 0.03, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.3, 1.6, 1.85])
    (probing,) = session.probings
    fields = [np.zeros_like(probing.displacement.points)]
    for level in levels[1:]:
        modulus = SHEAR / level
        poked = poke_session(
            session, PRESS, probing.contact, shear_modulus=modulus, poisson_ratio=NU
        )
        fixed = replace(session, probings=(replace(probing, contact=poked.contact),))
        graded = graded_session(refined_session(fixed))
        (observed,) = session_observations(graded, make_object_model(graded))
        moved = observed.response.value(NU) @ np.append(PRESS, 0.0) / modulus
        fields.append(moved.reshape(-1, 3))
    return levels, np.array(fields)


def by_quadrature(truth: CreepCompliance, times: np.ndarray, force: np.ndarray) -> np.ndarray:
    """int J(t - s) dF(s) of a force that rises in a straight line and is held, by quadrature."""
    rise = times[np.argmax(force >= 1.0)]

    def at(t: float) -> float:
        end = min(t, rise)
        return quad(lambda s: truth.at(np.array([t - s]))[0] / rise, 0.0, end, epsabs=1e-12)[0]

    return np.array([at(t) for t in times])


def sessions(count: int) -> tuple[np.ndarray, np.ndarray, Counter]:
    """Whole fits of a cube of two terms with noise of 1 % of the largest motion in every component,
    and 1.4 % of error in the force, which the fit takes as 1 % of the gauge and 1 % of the reading:
    errors of the logarithms of G at AT, whether intervals hold them, numbers of terms."""
    errors, hold, terms = [], [], Counter[int]()
    true = np.log(SHEAR * TWO.relaxation().at(AT))
    for seed in range(count):
        gain = 1.0 + 0.014 * np.random.default_rng(1000 + seed).standard_normal()
        with tempfile.TemporaryDirectory() as folder:
            path = write_creeping_session(
                Path(folder) / "cube", TWO, noise=0.01, seed=seed, instants=range(1, 320, 8),
                gain=gain,
            )  # fmt: skip
            relaxation = fit_session(read_session(path)).estimate.relaxation
        at = [
            point.modulus for point in relaxation.curve if min(abs(np.log(point.time / AT))) < 1e-6
        ]
        errors.append([np.log(modulus.value) - x for modulus, x in zip(at, true, strict=True)])
        hold.append([
            np.log(modulus.ci95[0]) <= x <= np.log(modulus.ci95[1])
            for modulus, x in zip(at, true, strict=True)
        ])  # fmt: skip
        terms[len(relaxation.terms)] += 1
    return np.array(errors), np.array(hold), terms


def seconds() -> tuple[float, float]:
    """Reading and fitting of one instant, and of a series of 319: the fastest of three."""
    fastest = []
    with tempfile.TemporaryDirectory() as folder:
        for name, instants in (("static", ()), ("series", None)):
            path = write_creeping_session(Path(folder) / name, TWO, noise=0.01, instants=instants)
            taken = []
            for _ in range(3):
                start = time.perf_counter()
                fit_session(read_session(path))
                taken.append(time.perf_counter() - start)
            fastest.append(min(taken))
    return fastest[0], fastest[1]


def _rms(values: np.ndarray) -> np.ndarray:
    return 100.0 * np.sqrt(np.mean(np.square(values), axis=0))


def main() -> None:
    """Print every figure."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    for far in (1.0, 2.0, 3.0, 5.0):
        print(f"ball, points beyond {far:g} radii: G at 1, 10, 100 s off by %", 100 * ball(far))
        print("the same with a free radius", 100 * ball(far, free_radius=True))
    print("ball, tip: off by %", 100 * ball(0.0, tip=True))
    print("ball, tip taken as linear: off by %", 100 * ball(0.0, tip=True, linear=True))
    print("cube under a ball: off by %", 100 * ball_on_cube())
    for name, truth in TRUTHS.items():
        for noise, correlation, every in (
            (0.003, 0.0, 1), (0.01, 0.0, 1), (0.01, 0.6, 1), (0.03, 0.0, 1), (0.01, 0.0, 16)
        ):  # fmt: skip
            result = draws(truth, noise=noise, count=count, correlation=correlation, every=every)
            rms = _rms(result["error"])
            # What is known to one part in five thousand is not a matter of an interval.
            hold = np.where(rms > 0.02, np.mean(result["hold"], axis=0), np.nan)
            print(
                f"{name}, noise {noise:g}, correlated {correlation:g}, {320 // every} instants:"
                f" terms {dict(result['terms'])}, rms % of G at 1, 10, 100 s, at once, long term"
                f" {rms.round(2)}, hold {hold.round(3)},"
                f" times {_rms(result['times']).round(1) if len(truth.times) else ''}",
                flush=True,
            )
    errors, hold, terms = sessions(40)
    print(f"sessions: terms {dict(terms)}, rms % {_rms(errors)}, hold {hold.mean(axis=0)}")
    print("seconds of a fit of one instant, of 319:", *seconds())


if __name__ == "__main__":
    main()
