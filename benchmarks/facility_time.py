"""How long one picture of each camera takes in the virtual facility, the arm in it."""

import numpy as np

from benchmarks.clock import shortest
from benchmarks.figure import FACILITY, Figure
from benchmarks.options import Options
from palpate.lab import choose_variant, read_lab_config
from palpate.lab.bench.arm import aim, rod_at
from palpate.lab.config_files import built_in
from palpate.lab.pictures.head import make_head
from palpate.lab.pictures.studio import make_studio, photograph


def measure(options: Options) -> list[Figure]:
    """The built-in half ball's three cameras, warm."""
    config = read_lab_config(built_in()["half-ball"])
    mesh, variant = config.specimen.mesh, choose_variant()
    rig = make_head(config.head, mesh)
    tip = aim(config.probes[0], config.arm, mesh, rng=np.random.default_rng(1))
    studio = make_studio(config, rig, variant, rng=np.random.default_rng(2))
    rest, rod = studio.mesh.vertices, rod_at(tip, tip.point, rig.cameras)
    seconds = shortest(
        lambda: photograph(studio, [rest], rod, rng=np.random.default_rng(3)),
        repeats=1 if options.quick else 5,
    )
    drawn, rays = len(studio.mesh.vertices), config.pictures.samples
    return [
        Figure(
            FACILITY, "one trinocular step rendered at 640 x 480", seconds, "s", must=2.0,
            reach=1.0, note=f"{drawn} vertices, {rays} rays a light and pixel, {variant.name}; lamp"
            " with soft shadows, light from everywhere",
        )
    ]  # fmt: skip
