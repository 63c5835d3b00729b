"""`palpate compile` says what it did; that real measurements find their kernels then is tested with
warming up (`tests/pipeline/test_warm_up.py`)."""

import numba

from palpate.app import environment
from palpate.app.commands import compile as module


def test_what_is_compiled_is_counted(palpate, monkeypatch):
    double = numba.njit(lambda x: 2 * x)
    monkeypatch.setattr(module, "warm_up", lambda _: (double(1), double(1.0)))
    code, out, _ = palpate("compile")
    assert code == 0
    assert out.startswith("2 kernels compiled in ")
    code, out, _ = palpate("compile")
    assert code == 0
    assert "were up to date" in out


def test_kernels_that_would_not_stay_are_not_compiled(palpate, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(environment, "_is_writable", lambda folder: False)
    monkeypatch.setattr(module, "warm_up", None)
    code, out, err = palpate("compile")
    assert (code, out) == (2, "")
    assert "set NUMBA_CACHE_DIR to a folder that can" in err
