"""`palpate lab plan`: a table of what to expect, and pictures of what will be seen."""

import cv2
import pytest
from lab.planned_sessions import SESSION, planned_session


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "bench"
    made.mkdir()
    return planned_session(made)


@pytest.mark.slow
def test_a_plan_tells_the_precision_and_shows_the_view(palpate, folder, tmp_path):
    code, out, _ = palpate("lab", "plan", folder, "--young-modulus", 5e4)
    assert code == 0
    # A title is broken where its table is narrower.
    text = " ".join(out.split())
    assert all(word in text for word in ("n01", "n02", "all", "c2", "E = 50 kPa, nu = 0.3"))
    names = {path.stem for path in (tmp_path / "bench-plan").glob("*.png")}
    assert names == {f"{a}_{b}" for a in ("rest", "n01", "n02") for b in ("c0", "c1", "c2")}
    rest, probed = (
        cv2.imread(str(tmp_path / "bench-plan" / f"{name}_c0.png"), 0) for name in ("rest", "n01")
    )
    assert rest.shape == (160, 200)
    assert rest[rest > 20].std() > 30
    # The tool before the object, dark.
    assert ((rest > 100) & (probed < 40)).sum() > 50


def test_a_contact_beside_the_object_is_refused(palpate, folder, tmp_path):
    (folder / "session.toml").write_text(SESSION.replace("[0, 0, 0.04]", "[0, 0, 0.08]"))
    code, out, err = palpate("lab", "plan", folder, "--young-modulus", 5e4)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert not (tmp_path / "bench-plan").exists()


def test_the_guess_is_needed(palpate, folder):
    code, _, err = palpate("lab", "plan", folder)
    assert code == 2
    assert "--young-modulus" in err
