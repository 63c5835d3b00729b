"""`palpate compile` says what it did; that real measurements find their kernels then is tested with
the rehearsals (`tests/pipeline/test_rehearsal.py`)."""

import numba

from palpate.app.commands import compile as module


def test_kernels_that_are_there_are_not_compiled(palpate, monkeypatch):
    # What needs no kernel: the processes that a rehearsal would run in are real.
    monkeypatch.setattr(module, "rehearse_flow", int)
    monkeypatch.setattr(module, "rehearse_fit", float)
    code, out, _ = palpate("compile")
    assert code == 0
    assert "were up to date" in out


def test_what_is_compiled_is_counted():
    double = numba.njit(lambda x: 2 * x)
    assert module._compiled(lambda: double(1)) == 1
    assert module._compiled(lambda: double(2)) == 0
    assert module._compiled(lambda: double(2.0)) == 1
