"""The numbered examples run as they are shipped, each with one checked number."""

import importlib.util
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run_example(name):
    """What the example's `main` gives."""
    spec = importlib.util.spec_from_file_location("example", EXAMPLES / name)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main()


def test_fit_session():
    # Truth 60 kPa (examples/half_ball/README.md); force noise of 1 % on six probings leaves about
    # 0.7 % in E, twice that is granted.
    assert run_example("01_fit_session.py") == pytest.approx(60e3, rel=0.015)


def test_import_displacements():
    # What lies between the true sphere and its mesh: points on an arc over edges of 2 to 4 mm are
    # up to 0.07 mm off. A wrong frame or unit would be centimetres.
    assert run_example("04_import_displacements.py") < 1e-4


def test_write_a_session():
    assert run_example("03_write_a_session.py") == 3  # of four rows one is nan


@pytest.mark.slow
def test_predict_a_push():
    # 0.95 of independent components; neighbours share errors, so that a tenth more is usual.
    assert run_example("05_predict_a_push.py") == pytest.approx(0.95, abs=0.06)


@pytest.mark.slow
def test_likelihood():
    # The force error moves G alone, noise moves G and nu against each other; the sign is theirs,
    # the size is the example's own number.
    assert run_example("06_likelihood.py") == pytest.approx(-0.17, abs=0.05)


@pytest.mark.slow
def test_where_to_push():
    bounds = run_example("07_where_to_push.py")
    together = bounds.pop("all")
    # Probings tell independently once G is shared; together they beat the sum of what each tells
    # alone, as no probing has to find G by itself.
    assert together < sum(bound**-2 for bound in bounds.values()) ** -0.5
    assert together > 0.5 * min(bounds.values()) / len(bounds) ** 0.5


@pytest.mark.slow
def test_stress_inside():
    # Below a patch on a half space the axis carries at most about 0.7 of the peak pressure as von
    # Mises stress; the peak of the smooth profile is 3 F / (pi a^2).
    peak = 3 * 0.75 / (3.141592653589793 * 0.0055**2)
    assert 0.3 * peak < run_example("08_stress_inside.py") < 0.7 * peak


@pytest.mark.slow
def test_every_material():
    # The reduced model promises a residual of 1e-8 at the ends of its range (make_reduced_model).
    assert run_example("09_every_material.py") < 2e-7


@pytest.mark.slow
def test_many_fits():
    # Twelve intervals of 95 %: fewer than nine hold the truth once in 300 such series.
    assert run_example("10_many_fits.py") >= 9 / 12


def test_range_flow():
    # The median of 500 points that share pixels: about a tenth of one point's sigma, which is 1, 1
    # and 3 micrometres; and the bias of 0.005 px, 1.5 micrometres across and more in depth.
    printed = run_example("11_range_flow.py")
    assert printed == pytest.approx([2e-4, -1e-4, 3e-4], abs=2e-6)


@pytest.mark.slow
def test_virtual_measurement():
    # Two of the standard deviations that the fit reports: 1.1 kPa and 0.006.
    young, poisson = run_example("12_virtual_measurement.py")
    assert young == pytest.approx(52e3, abs=2.2e3)
    assert poisson == pytest.approx(0.21, abs=0.012)


def test_own_model():
    # Truth 0.40; three of the reported standard deviations of 0.00017.
    assert run_example("13_own_model.py") == pytest.approx(0.40, abs=5e-4)


def test_every_example_is_tested_short_and_numbered():
    files = sorted(path.name for path in EXAMPLES.glob("*.py"))
    tested = Path(__file__).read_text(encoding="utf-8")
    assert [name for name in files if f'run_example("{name}")' not in tested] == []
    assert [int(name[:2]) for name in files] == list(range(1, len(files) + 1))
    lengths = {name: len((EXAMPLES / name).read_text().splitlines()) for name in files}
    assert {name: length for name, length in lengths.items() if length >= 70} == {}


def test_examples_stay_small():
    files = [path for path in EXAMPLES.rglob("*") if path.is_file()]
    # Two megabytes is what the project allows itself for examples.
    assert sum(path.stat().st_size for path in files if path.suffix != ".pyc") < 2e6


@pytest.mark.slow
def test_whole_result():
    # 52 g sank the middle of the end face by 10.4 mm (load52_a.csv): 20 g by 4.0 mm, and the
    # contact itself gives way a little more.
    assert run_example("02_whole_result.py") == pytest.approx(4.0e-3 * 1.03, rel=0.03)


@pytest.mark.slow
def test_touch_in_real_time():
    # The example's own number; a change of the mesh or the elements may move it by some 0.1 %.
    assert run_example("14_touch_in_real_time.py") == pytest.approx(0.815, rel=0.01)


def test_relaxation_curve():
    # Three exponentials over five decades of a curve without a time of its own: half a decade
    # away from the next time a term is off by a few per cent of its own 2 to 6 %.
    assert run_example("15_relaxation_curve.py") < 0.01
