"""A mesh too large is refused before any work, with the size that would do."""

import subprocess
import sys
from pathlib import Path

import pytest

from palpate.bem import check_memory
from palpate.bem.system.memory import memory_needed
from palpate.errors import InputError


def test_a_mesh_that_fits_is_let_through():
    check_memory(2562, available=24e9)


def test_a_mesh_that_does_not_fit_is_refused():
    # 16 doubles a pair and 540 vectors: 13.3 GB for 10 000 vertices; 90 % of 8 GB hold 7200.
    with pytest.raises(InputError, match=r"10000 vertices.* 13\.3 GB.* at most 7200 vertices"):
        check_memory(10_000, available=8e9, dense=True)


def test_what_needs_no_matrices_needs_less():
    check_memory(10_000, available=8e9)
    # 150 kB a vertex and 660 vectors of three: 166 kB; 90 % of 8 GB less the program hold 41 000.
    with pytest.raises(InputError, match=r"100000 vertices.* 19\.0 GB.* at most 36500 vertices"):
        check_memory(100_000, available=8e9)


def test_where_only_dense_matrices_fit_their_size_is_offered():
    # 90 % of 1.3 GB do not hold an operator for 5001 vertices, but matrices for 2400.
    with pytest.raises(InputError, match=r"at most 2400 vertices"):
        check_memory(6000, available=1.3e9)


def test_what_is_offered_fits():
    with pytest.raises(InputError) as refused:
        check_memory(500_000, 17, available=8e9)
    offered = int(str(refused.value).split("at most ")[1].split()[0])
    check_memory(offered, 17, available=8e9)
    with pytest.raises(InputError):
        check_memory(offered + 200, 17, available=8e9)


def test_the_machine_is_asked():
    with pytest.raises(InputError, match="simplify the surface"):
        check_memory(100_000_000)


def test_a_limit_of_the_process_counts():
    code = (
        "import resource, palpate.bem as b\n"
        "resource.setrlimit(resource.RLIMIT_AS, (4 << 30,) * 2)\n"
        "try: b.check_memory(6000, dense=True)\n"
        "except b.system.memory.InputError as e: print(e)"
    )
    src = str(Path(__file__).parents[3] / "src")
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={"PYTHONPATH": src}
    ).stdout
    assert "3.9 GB can be used here" in said


def test_every_probing_needs_memory():
    # Six columns of 3 x 1000 unknowns, 90 vectors each.
    one, two = (memory_needed(1000, count, rollers=False) for count in (1, 2))
    assert two - one == 6 * 3000 * 90 * 8


@pytest.mark.parametrize(("vertices", "peak"), [(642, 0.526e9), (2562, 1.47e9)])
def test_what_is_said_is_what_a_fit_of_17_probings_took(vertices, peak):
    """Largest resident set of `palpate fit`, by `python -m benchmarks.run --only memory`."""
    # Balls need a tenth of the 80 basis vectors that are counted.
    assert 1.0 < memory_needed(vertices, 17) / peak < 1.4


def test_further_factors_take_a_matrix_each():
    one, three = (memory_needed(1000, 1, n_factors=count) for count in (1, 3))
    # At least the nine doubles of each pair of vertices.
    assert 2 * 9 * 8e6 <= three - one < 2 * 13 * 8e6
