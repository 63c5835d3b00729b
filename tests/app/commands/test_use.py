"""`palpate poke`: the tables it prints, where the material comes from, and what it refuses."""

import json
from typing import get_args

import numpy as np
import pytest
from estimate_samples import SHEAR
from exported_result import written_result

from palpate.app.commands import use as use_command
from palpate.app.commands.use import Simulator
from palpate.bem import InteriorState
from palpate.pipeline import PokedState
from palpate.records import folder_changes
from palpate.simulation import FORMATS

PUSH = ("--force", 0.3, 0, "-0.8", "--at", 0.02, 0.02, 0.04)
MATERIAL = ("--shear-modulus", 2e4, "--poisson-ratio", 0.3)


@pytest.fixture
def asked(monkeypatch):
    """The model replaced; what it was asked for is collected."""
    calls = []

    def poke_session(session, force, contact, *, interior, **options):
        calls.append((force, contact, interior, options | {"smooth": session.smooth}))
        inside = None
        if interior is not None:
            stress = np.tile(np.diag([0.0, 0.0, -3e3]), (len(interior), 1, 1))
            inside = InteriorState(1e-4 * np.ones_like(interior), stress)
        top = np.array([0.02, 0.02, 0.04])
        moved = np.array([3e-4, 1e-12, -4e-4])
        return PokedState(contact, moved, 2.0 * moved, top, -force, inside)

    monkeypatch.setattr(use_command, "poke_session", poke_session)
    return calls


def test_displacement_and_stress_are_printed(palpate, asked, cube_session):
    inside = ("--interior", 0.02, 0.02, 0.02, "--interior", "10mm", "2cm", "30mm")
    code, out, err = palpate("poke", cube_session, *PUSH, *MATERIAL, *inside)
    assert (code, err) == (0, "")
    rows = {line[:10].strip(): line.split() for line in out.splitlines()}
    assert rows["contact"][-4:] == ["0.300,", "0.000,", "-0.400", "0.5"]
    assert rows["largest"][-4:] == ["0.600,", "0.000,", "-0.800", "1"]
    # 3 kPa of compression: its von Mises stress is 3 kPa, too.
    stresses = [line.split()[2:] for line in out.splitlines() if line.strip().startswith("inside")]
    assert stresses[2] == stresses[3] == ["0.00", "0.00", "-3.00", "0.00", "0.00", "0.00", "3"]
    text = " ".join(out.split())
    assert "G = 20 kPa, nu = 0.3; a force of (0.300, 0.000, -0.800) N" in text
    assert "over a radius of 6 mm" in text
    ((force, contact, interior, _),) = asked
    np.testing.assert_array_equal(force, [0.3, 0.0, -0.8])
    np.testing.assert_array_equal(contact.point, [0.02, 0.02, 0.04])
    np.testing.assert_array_equal(interior, [[0.02, 0.02, 0.02], [0.01, 0.02, 0.03]])


def test_a_push_beyond_small_deformation_is_said(palpate, monkeypatch, cube_session):
    """A real model: the cube is 69 mm across, and gives way by more than a tenth of that."""
    code, _, err = palpate("poke", cube_session, *PUSH[:3], "-40", *PUSH[4:], *MATERIAL)
    assert (code, "outside small deformation" in err) == (0, True)
    code, _, err = palpate("poke", cube_session, *PUSH[:3], "-1e30", *PUSH[4:], *MATERIAL)
    assert code == 2
    assert "must be newtons" in err


def test_without_interior_points_there_is_one_table(palpate, asked, cube_session):
    _, out, _ = palpate("poke", cube_session, *PUSH, *MATERIAL)
    assert "Stress" not in out
    assert asked[0][2] is None


def test_the_material_is_youngs_modulus_or_the_shear_modulus(palpate, asked, cube_session):
    palpate("poke", cube_session, *PUSH, "--young-modulus", 5.2e4, "--poisson-ratio", 0.3)
    palpate("poke", cube_session, *PUSH, *MATERIAL, "--radius", 0.002, "--surface", "flat")
    (_, _, _, first), (_, contact, _, second) = asked
    # G = E / (2 (1 + nu))
    assert first["shear_modulus"] == pytest.approx(2e4, rel=1e-12)
    assert (first["poisson_ratio"], second["shear_modulus"]) == (0.3, 2e4)
    assert (contact.radius, second["smooth"]) == (0.002, False)


def estimate(folder, *, lost=(), shear=2.5e4):
    """A result folder of `palpate fit` with these constants."""
    names = {"shear_modulus": shear, "poisson_ratio": 0.2, "young_modulus": 6e4}
    # Ten per cent of each; a lost one has its whole range.
    sizes = {name: value or 1.0 for name, value in names.items()}
    ends = {name: [0.8 * size, 1.2 * size] for name, size in sizes.items()}
    ends |= {name: [0.0, 0.5 if name == "poisson_ratio" else 1e9] for name in lost}
    folder.mkdir()
    content = {
        "format": "palpate-estimate/1", "probes": [], "seconds": {},
        "status": f"{lost[0]}_not_identifiable" if lost else "ok",
        "identifiable": {name: name not in lost for name in names},
        **{
            name: {"value": value, "std": 0.1 * sizes[name], "ci95": ends[name]}
            for name, value in names.items()
        },
    }  # fmt: skip
    (folder / "estimate.json").write_text(json.dumps(content))
    return folder


def test_the_material_may_come_from_a_fit(palpate, asked, cube_session, tmp_path):
    folder = estimate(tmp_path / "result")
    assert palpate("poke", cube_session, *PUSH, "--result", folder)[0] == 0
    assert palpate("poke", cube_session, *PUSH, "--result", folder / "estimate.json")[0] == 0
    for _, _, _, options in asked:
        assert (options["shear_modulus"], options["poisson_ratio"]) == (2.5e4, 0.2)


def test_a_result_may_stand_for_its_session(palpate, asked, tmp_path):
    folder = written_result(tmp_path)
    assert palpate("poke", folder, *PUSH)[0] == 0
    assert palpate("poke", folder, *PUSH, *MATERIAL)[0] == 0
    fitted, given = (options["shear_modulus"] for _, _, _, options in asked)
    assert fitted == pytest.approx(SHEAR)
    assert given == 2e4


def test_an_estimate_that_is_not_ok_is_used_with_a_note(palpate, asked, cube_session, tmp_path):
    folder = estimate(tmp_path / "result", lost=["poisson_ratio"])
    code, _, err = palpate("poke", cube_session, *PUSH, "--result", folder)
    assert code == 0
    assert "palpate: note:" in err
    assert "Poisson's ratio is not determined by the data" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "give the material in one way"),
        (("--shear-modulus", 2e4), "give the material in one way"),
        ((*MATERIAL, "--young-modulus", 5e4), "give the material in one way"),
        ((*MATERIAL, "--result", "."), "give the material in one way"),
        (("--poisson-ratio", 0.6, "--young-modulus", 5e4), "--poisson-ratio is 0.6; must be"),
        (("--poisson-ratio", "-1", "--young-modulus", 5e4), "--poisson-ratio is -1; must be"),
        (("--poisson-ratio", 0.3, "--young-modulus", "-1"), "--young-modulus is -1; must be"),
        ((*MATERIAL[2:], "--shear-modulus", "0"), "--shear-modulus is 0; must be 1 to"),
        (("--result", "nowhere"), "nowhere"),
        ((*MATERIAL, "--radius", "-0.1"), "radius is -0.1"),
        ((*MATERIAL, "--force", 0, 0, 0), "--force is zero"),
    ],
)
def test_bad_input_ends_with_two_and_one_message(palpate, asked, cube_session, options, message):
    push = PUSH[4:] if "--force" in options else PUSH
    code, out, err = palpate("poke", cube_session, *push, *options)
    assert (code, out, asked) == (2, "", [])
    assert message in err
    assert "Traceback" not in err


def test_an_estimate_without_a_value_is_refused(palpate, asked, cube_session, tmp_path):
    folder = estimate(tmp_path / "result", lost=["shear_modulus"], shear=None)
    code, _, err = palpate("poke", cube_session, *PUSH, "--result", folder)
    assert code == 2
    assert "no value of the shear modulus" in err


def test_a_contact_beside_the_object_is_refused(palpate, cube_session):
    options = ("--force", 0, 0, -1, "--at", 0.02, 0.02, 0.08, *MATERIAL)
    code, out, err = palpate("poke", cube_session, *options)
    assert (code, out) == (2, "")
    assert "the contact point is 40 mm from the surface" in err
    assert "check the frame and the units of the point (at)" in err
    assert err.count("\n") == 1


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return written_result(tmp_path_factory.mktemp("exported"))


def test_the_folder_holds_the_simulators_files(palpate, result, tmp_path):
    code, out, err = palpate("export", result, "--to", "obj")
    assert code == 0
    folder = tmp_path / "result-obj"
    names = {path.name for path in folder.iterdir()}
    assert names == {"surface.obj", "palpate.json", "README.txt", "contents.txt", "inputs.txt"}
    assert "Push written along: probing n02, left out of the estimate" in out
    assert "no density: 1000 kg/m^3 was written" in err
    assert folder_changes(folder)[1] == {}


def test_a_folder_that_holds_something_else_is_left_alone(palpate, result, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    code, _, err = palpate("export", result, "--to", "obj", "--out", "mine")
    assert code == 2
    assert "holds files that are no result of Palpate's" in err
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["notes.txt"]


def test_an_export_to_another_simulator_is_left_alone(palpate, result):
    assert palpate("export", result, "--to", "obj", "--out", "made")[0] == 0
    assert palpate("export", result, "--to", "obj", "--out", "made")[0] == 0
    code, _, err = palpate("export", result, "--to", "genesis", "--out", "made")
    assert code == 2
    assert "is a result of `palpate export --to obj`" in err


def test_a_negative_edge_is_refused_as_a_number(palpate, result):
    code, _, err = palpate("export", result, "--to", "vtu", "--edge", "-1mm")
    assert code == 2
    assert "edge is -0.001 m; must be positive" in err


def test_the_edge_may_have_a_unit(palpate, result):
    code, _, err = palpate("export", result, "--to", "vtu", "--edge", "900000 mm")
    assert (code, "0.0693 m across" in err) == (2, True)


def test_the_command_knows_every_format():
    assert set(get_args(Simulator)) == set(FORMATS)


def test_an_unknown_simulator_is_refused(palpate, result):
    code, _, err = palpate("export", result, "--to", "blender")
    assert code == 2
    assert "mujoco" in err
