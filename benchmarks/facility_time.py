"""How long one picture of each camera takes in the virtual facility, the arm in it."""

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np

from benchmarks.clock import shortest
from benchmarks.figure import FACILITY, Figure
from benchmarks.options import Options
from palpate.lab import choose_variant, read_lab_config, scene
from palpate.lab.arm import aim, rod_at
from palpate.lab.config_files import built_in
from palpate.lab.head import make_head
from palpate.lab.studio import make_studio, photograph


def measure(options: Options) -> list[Figure]:
    """The built-in half ball's three cameras, warm."""
    config = read_lab_config(built_in()["half-ball"])
    mesh, variant = config.specimen.mesh, choose_variant()
    rig = make_head(config.head, mesh)
    tip = aim(config.probes[0], config.arm, mesh, rng=np.random.default_rng(1))
    studio = make_studio(config, rig, variant, rng=np.random.default_rng(2))
    rest, rod = studio.mesh.vertices, rod_at(tip, tip.point, rig.cameras)
    repeats = 1 if options.quick else 5

    def step() -> None:
        photograph(studio, [rest], rod, rng=np.random.default_rng(3))

    seconds = shortest(step, repeats=repeats)
    with _first_hits_only():
        floor = shortest(step, repeats=repeats)
    drawn, rays = len(studio.mesh.vertices), config.pictures.samples
    return [
        Figure(
            FACILITY, "one trinocular step rendered at 640 x 480", seconds, "s",
            note=f"{drawn} vertices, {rays} rays a light and pixel, {variant.name}; lamp"
            " with soft shadows, light from everywhere; floor: to find what each ray hits first,"
            f" without any light, takes Mitsuba {floor:.1f} s",
        )
    ]  # fmt: skip


@contextmanager
def _first_hits_only() -> Iterator[None]:
    """The same scenes and rays, but Mitsuba looks for the first hit of each ray and no more."""
    passes = scene._passes

    def without_light(mitsuba, bodies, light):
        depth = mitsuba.load_dict({"type": "depth"})
        return [(ray, depth) for ray, _ in passes(mitsuba, bodies, light)]

    with patch.object(scene, "_passes", without_light):
        yield
