"""A mesh too large is refused before any work, with the size that would do."""

import pytest

from palpate.bem import check_memory
from palpate.errors import InputError


def test_a_mesh_that_fits_is_let_through():
    check_memory(2562, available=24e9)


def test_a_mesh_that_does_not_fit_is_refused():
    # 22 doubles a pair: 17.6 GB for 10 000 vertices; 90 % of 8 GB hold 6396.
    with pytest.raises(InputError, match=r"10000 vertices.* 18 GB.* at most 6300 vertices"):
        check_memory(10_000, available=8e9)


def test_the_machine_is_asked():
    with pytest.raises(InputError, match="simplify the surface"):
        check_memory(10_000_000)
