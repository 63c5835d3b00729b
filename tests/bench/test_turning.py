"""An object without a mesh, turned before cameras that were calibrated with a board."""

from dataclasses import replace

import numpy as np
import pytest
from bench.drawn_world import Script, drawn_bench, drawn_body, small_config
from scan_views import toy

from palpate.bench import measure, virtual_bench
from palpate.bench.turning import SCANNED, scan_object
from palpate.calibration import Charuco
from palpate.geometry import TriangleMesh, read_mesh
from palpate.records import read_rig, write_rig
from palpate.scanning import distances
from palpate.vision import project

BOARD = Charuco(9, 7, 0.012, 0.009)
STEP = 30.0


def toy_bench(folder, board=None):
    """A bench whose cameras see a toy, and that knows nothing of it."""
    config = small_config()
    config = replace(config, specimen=replace(config.specimen, mesh=toy()))
    bench = virtual_bench(config, draw=drawn_body, board=board)
    world = bench.cameras[0]._world

    def supply(_):
        world.shown = None

    bench = replace(bench, arm=None, head={}, contact=None, folder=folder, supply=supply)
    return bench, world


class Turner(Script):
    """Turns the object by some degrees whenever asked to, until it has gone round."""

    def __init__(self, world, *steps, **options):
        super().__init__(**options)
        self.world, self.steps, self.angle = world, list(steps), 0.0
        self.rest = world.body.vertices

    def choose(self, text, options):
        if "Turn it by some 30 degrees" not in text:
            return super().choose(text, options)
        self.asked.append(text)
        if not self.steps:
            return options[1]
        self.angle += self.steps.pop(0)
        object.__setattr__(self.world.body, "vertices", self.turned(self.rest))
        self.world._drawn = None
        return options[0]

    def turned(self, points):
        c, s = np.cos(np.radians(self.angle)), np.sin(np.radians(self.angle))
        return points @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T


@pytest.mark.slow
def test_an_object_without_a_mesh_is_turned_and_measured(tmp_path):
    """From a board to the question where to press, with the mesh where the object stands."""
    there, folder = tmp_path / "bench", tmp_path / "session"
    there.mkdir()
    folder.mkdir()
    bench, world = toy_bench(there, BOARD)
    # At first too far: that view does not join.
    script = Turner(world, 100.0, -60.0, *[40.0] * 7)
    measure(bench, script, folder, dry_run=True)
    assert sum("does not count" in text for text in script.told) == 1
    assert "8 views, turned by 280 degrees in all" in script.asked[-6]
    mesh = read_mesh(folder / SCANNED)
    truth = TriangleMesh(script.turned(toy().vertices), toy().triangles)
    # Cameras that look down steeply see what is above its widest part, at 30 mm: 12 points on a
    # centimetre square, and chords of triangles of 3 mm.
    seen = mesh.vertices[:, 2] > 0.04
    assert np.quantile(distances(mesh.vertices[seen], truth), 0.9) < 3e-4
    rig = read_rig(folder / "rig.toml")
    for a, b in zip(rig.cameras, world.rig.cameras, strict=True):
        gap = project(a, truth.vertices) - project(b, truth.vertices)
        # The mesh is in the frame of the board's place, and nobody dragged it: as well known as
        # the board's corners, some tenths of a pixel.
        assert np.sqrt(np.mean(gap**2)) < 0.3


@pytest.mark.slow
def test_views_of_a_ball_do_not_join(tmp_path):
    """They do not tell how it was turned; what was taken before is gone on with."""
    bench = drawn_bench()
    write_rig(tmp_path / "rig.toml", bench.rig)
    script = Turner(bench.cameras[0]._world, STEP)
    for _ in range(2):
        scan_object(bench, script, tmp_path, tmp_path / "rig.toml")
    assert sum("does not fix how view" in text for text in script.told) == 1
    assert [text.split(",")[0] for text in script.asked[1:]] == ["1 views"] * 3
    assert len(list((tmp_path / "scan").glob("*_c0.png"))) == 1
