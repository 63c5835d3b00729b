"""What a machine has, and work that it refuses: estimates are compared with what is taken."""

import subprocess
import sys
from pathlib import Path

import pytest
from surfaces import box

from palpate.errors import InputError
from palpate.geometry import enclosed_volume
from palpate.machine import check_disk_for, check_memory_for, free_disk, machine_memory
from palpate.solids import body_memory, check_solid_size, make_solid, node_count
from palpate.solids.sizes import solid_memory

# Peak memory [bytes] of filling a cube and of factorising its stiffness, in a process of its own.
_MEASURE = """
import re
from pathlib import Path
from surfaces import box
from palpate.solids import make_body, make_solid

def peak():
    # Not that of `resource`: a process that starts has the peak of the one that started it.
    return 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])

cube = box(size=(0.04, 0.04, 0.04), cells=(4, 4, 4))
make_solid(cube, edge=0.01)
start = peak()
solid = make_solid(cube, edge=0.04 / 12)
filled = peak()
make_body(solid, solid.nodes[:, 2] < 1e-9, shear_modulus=1e4, poisson_ratio=0.4)
print(len(solid.nodes), filled - start, peak() - start)
"""


def test_what_fits_is_let_through_and_what_does_not_is_refused(tmp_path: Path):
    check_memory_for("it", 0.89e9, "less", available=1e9)
    with pytest.raises(
        InputError, match=r"^it would take 1\.0 GB of memory; 0\.9 GB can be .*: less"
    ):
        check_memory_for("it", 1e9, "less", available=1e9)
    check_disk_for("it", 1.0, "less", tmp_path)
    with pytest.raises(InputError, match=r"it would take .* of disk in"):
        check_disk_for("it", 1.0 + free_disk(tmp_path), "less", tmp_path)
    assert 1e8 < machine_memory() < 1e16


def test_a_disk_that_is_not_there_has_no_limit():
    assert free_disk(Path("/no/such/folder")) == float("inf")


def test_the_edge_that_is_offered_for_tetrahedra_fits(monkeypatch: pytest.MonkeyPatch):
    cube = box(size=(0.04, 0.04, 0.04))
    monkeypatch.setattr("palpate.machine.machine_memory", lambda: 24e9)
    with pytest.raises(InputError, match=r"edge of 0\.1 mm .* nodes, which would take 1120.0 GB"):
        check_solid_size(cube, 1e-4)
    # 12.5 nodes of 1400 bytes for each cube of an edge: 21.6 GB hold those of 0.373 mm.
    with pytest.raises(InputError, match=r"use an edge of 0\.39 mm or more"):
        check_solid_size(cube, 1e-4)
    check_solid_size(cube, 3.9e-4)


def test_nodes_are_counted_before_they_are_made():
    for size in ((0.04, 0.04, 0.04), (0.08, 0.03, 0.02)):
        mesh = box(size=size, cells=(4, 4, 4))
        edge = float(enclosed_volume(mesh) ** (1.0 / 3.0)) / 7.0
        made = len(make_solid(mesh, edge=edge).nodes)
        assert 0.5 * made < node_count(mesh, edge) < 2.0 * made


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads the peak from /proc")
def test_estimates_of_memory_are_within_a_factor_of_two():
    made = subprocess.run(
        [sys.executable, "-c", _MEASURE], capture_output=True, text=True, check=True,
        cwd=Path(__file__).parents[1],
    )  # fmt: skip
    nodes, filled, factorised = map(float, made.stdout.split())
    estimate = node_count(box(size=(0.04, 0.04, 0.04)), 0.04 / 12)
    assert 0.5 * nodes < estimate < 2.0 * nodes
    assert 0.5 * filled < solid_memory(nodes) < 2.0 * filled
    assert 0.5 * factorised < body_memory(nodes) < 2.0 * factorised
