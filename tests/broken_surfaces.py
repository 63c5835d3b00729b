"""Broken surfaces whose sound original is known: the defects that Thingi10K counts, and scans'.

Zhou and Jacobson, Thingi10K: a dataset of 10,000 3D-printing models (2016), sorts printed models by
open, non-manifold, self-intersecting, degenerate, inconsistently oriented and in several pieces;
Attene, Campen and Kobbelt, Polygon mesh repairing (ACM Comput. Surv. 45, 2013), name the others.
"""

from dataclasses import dataclass

import numpy as np
import trimesh

from palpate.geometry import TriangleMesh

RADIUS = 0.03


@dataclass(frozen=True)
class Broken:
    """A broken surface; the volume of the sound one, or words of the refusal."""

    name: str
    mesh: TriangleMesh
    volume: float | None = None
    tolerance: float = 1e-9
    done: str = ""
    refused: str = ""
    support: str | None = None


def ball(radius=RADIUS, centre=(0.0, 0.0, 0.0), *, fine=3):
    body = trimesh.creation.icosphere(fine, radius)
    return np.array(body.vertices) + centre, np.array(body.faces)


def box(size=(0.04, 0.03, 0.02), centre=(0.0, 0.0, 0.0)):
    body = trimesh.creation.box(size)
    return np.array(body.vertices) + centre, np.array(body.faces)


def together(*parts):
    offset = np.cumsum([0, *(len(v) for v, _ in parts)])
    return np.concatenate([v for v, _ in parts]), np.concatenate(
        [f + k for (_, f), k in zip(parts, offset, strict=False)]
    )


def made(part):
    return TriangleMesh(vertices=part[0], triangles=np.ascontiguousarray(part[1]))


def volume(part):
    v, f = part
    a, b, c = v[f[:, 0]], v[f[:, 1]], v[f[:, 2]]
    return float(np.einsum("ka,ka->k", a, np.cross(b, c)).sum() / 6.0)


def without_cap(part, height):
    v, f = part
    return v, f[~(v[f][:, :, 2] > height).all(axis=1)]


def with_turned(part):
    v, f = part
    f = f.copy()
    f[::3] = f[::3, ::-1]
    return v, f


def apart(part):
    """Every triangle with vertices of its own, off by a rounding of single precision."""
    v, f = part
    rng = np.random.default_rng(0)
    corners = v[f].reshape(-1, 3)
    return corners + rng.normal(0, 2e-6, corners.shape), np.arange(len(corners)).reshape(-1, 3)


def with_t_junctions(part):
    """Some triangles cut in two, their neighbours not told."""
    v, f = part
    v, f = list(v), list(map(tuple, f))
    for k in range(0, 60, 12):
        a, b, c = f[k]
        v.append(0.5 * (v[a] + v[b]))
        f[k] = (a, len(v) - 1, c)
        f.append((len(v) - 1, b, c))
    return np.array(v), np.array(f)


def with_flat_triangles(part):
    """Slivers of no area between a cut edge and the neighbour that is not cut."""
    v, f = part
    v, f = list(v), list(map(tuple, f))
    for k in range(0, 60, 12):
        a, b, c = f[k]
        v.append(0.5 * (v[a] + v[b]))
        m = len(v) - 1
        f[k] = (a, m, c)
        f += [(m, b, c), (a, b, m)]
    return np.array(v), np.array(f)


def with_wall():
    """Two boxes of one skin with the wall between them."""
    x, y, z = np.meshgrid([-0.02, 0.0, 0.02], [-0.015, 0.015], [-0.01, 0.01], indexing="ij")
    v = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)

    def quads(i):
        low = [4 * i, 4 * i + 1, 4 * i + 3, 4 * i + 2]
        high = [k + 4 for k in low]
        ring = [(low[k], low[(k + 1) % 4], high[(k + 1) % 4], high[k]) for k in range(4)]
        return ring, low, high

    ring_a, low, middle = quads(0)
    ring_b, _, high = quads(1)
    faces = [*ring_a, *ring_b, tuple(low[::-1]), tuple(high), tuple(middle)]
    f = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    return v, np.array(f)


def overlapping_ring():
    """A bent bar whose ends pass into each other, one skin, and the volume of the whole ring."""
    turns, around = 48, 24
    step = 2.0 * np.pi / turns
    # Four steps too far, and off by half a step, so that no two triangles coincide.
    along = step * np.concatenate([np.arange(turns), turns + 0.5 + np.arange(4)])
    phi = 2.0 * np.pi * np.arange(around) / around
    r = 0.008
    out = RADIUS + r * np.cos(phi)
    v = np.stack(
        [
            np.cos(along)[:, None] * out, np.sin(along)[:, None] * out,
            np.broadcast_to(r * np.sin(phi), (len(along), around)),
        ],
        axis=2,
    ).reshape(-1, 3)  # fmt: skip
    k = np.arange(len(v)).reshape(len(along), around)
    a, b = k[:-1], k[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    f = [np.stack([p.ravel() for p in q], axis=1) for q in ((a, b, c), (a, c, d))]
    for ring, turn in ((k[0], 1), (k[-1], -1)):
        middle = len(v)
        v = np.concatenate([v, v[ring].mean(axis=0)[None]])
        fan = np.stack([ring, np.roll(ring, -1), np.full(around, middle)], axis=1)
        f.append(fan[:, ::turn])
    section = 0.5 * around * np.sin(2.0 * np.pi / around) * r**2
    return (v, np.concatenate(f)), turns * np.sin(step) * RADIUS * section


def overlap_volume():
    """Two boxes of 40 x 30 x 20 mm, moved by 20, 10 and 0 mm."""
    single = 0.04 * 0.03 * 0.02
    return 2.0 * single - 0.02 * 0.02 * 0.02


def moebius():
    n, w = 60, 0.008
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    s = np.array([-w, w])
    r = RADIUS + s[None] * np.cos(t / 2)[:, None]
    v = np.stack(
        [r * np.cos(t)[:, None], r * np.sin(t)[:, None], s[None] * np.sin(t / 2)[:, None]], axis=2
    ).reshape(-1, 3)
    f = []
    for k in range(n):
        a, b = 2 * k, 2 * k + 1
        c, d = (2 * k + 2, 2 * k + 3) if k < n - 1 else (1, 0)
        f += [(a, b, d), (a, d, c)]
    return v, np.array(f)


def sheet():
    x, y = np.meshgrid(np.linspace(0, 0.05, 12), np.linspace(0, 0.04, 10), indexing="ij")
    v = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    k = np.arange(120).reshape(12, 10)
    a, b, c, d = k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]
    f = np.concatenate([np.stack([p.ravel() for p in q], axis=1) for q in ((a, b, c), (a, c, d))])
    return v, f


def broken_surfaces() -> list[Broken]:
    """The table of the figure: every kind once, mended or refused."""
    whole, brick = ball(), box()
    turned_inside = (whole[0] * 0.4, whole[1][:, ::-1])
    open_box = without_cap(box((0.04, 0.03, 0.02)), 0.009)
    dust = ball(0.0008, (0.05, 0.0, 0.0), fine=1)
    return [
        Broken("hole", made(without_cap(whole, 0.029)), volume(whole), 5e-3, "hole"),
        Broken("flipped faces", made(with_turned(whole)), volume(whole), 1e-9, "flipped triangle"),
        Broken("duplicate shell", made(together(whole, (whole[0] + 1e-6, whole[1]))),
               volume(whole), 2e-4, "duplicate shell"),
        Broken("duplicate triangles", made((whole[0], np.concatenate([whole[1], whole[1][:200]]))),
               volume(whole), 1e-9, "duplicate triangle"),
        Broken("unmerged vertices", made(apart(whole)), volume(whole), 1e-4, "unmerged vertex"),
        Broken("T-junctions", made(with_t_junctions(whole)), volume(whole), 1e-9, "T-junction"),
        Broken("degenerate triangles", made(with_flat_triangles(whole)), volume(whole), 1e-9,
               "degenerate triangle"),
        Broken("overlapping parts", made(together(brick, box(centre=(0.02, 0.01, 0.0)))),
               overlap_volume(), 1e-6, "overlapping part"),
        Broken("self-intersection", made(overlapping_ring()[0]), overlapping_ring()[1],
               0.012, "self-intersection"),
        Broken("inner wall", made(with_wall()), volume(brick), 1e-9, "inner wall"),
        Broken("stray pieces", made(together(whole, dust)), volume(whole), 1e-9, "stray piece"),
        Broken("open base", made(open_box), volume(brick), 1e-9, "open base", support="z=0.01"),
        Broken("base missing, support not said", made(open_box), refused="does not close"),
        Broken("thin sheet", made(sheet()), refused="without thickness", support="z=0"),
        Broken("one-sided", made(moebius()), refused="one-sided"),
        Broken("cavity", made(together(whole, turned_inside)), refused="hollow"),
        Broken("two objects", made(together(brick, box(centre=(0.06, 0.0, 0.0)))),
               refused="2 separate objects"),
    ]  # fmt: skip
