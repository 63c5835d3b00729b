"""A name that somebody wrote into a file becomes a file where it is meant to be, or is refused."""

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest
from cube_session import cube_session as cube_session
from lab.lab_configs import HALF_BALL
from lab.planned_sessions import SESSION, planned_session

from palpate.errors import CalibrationError, InputError, RecordError
from palpate.lab import Material, Variant, facility, make_session, planned_pictures, read_lab_config
from palpate.records import Rig, check_file_names, file_stems, path_below, read_rig, read_session

# What is wrong with it, as the message says.
REFUSED = {
    "../../evil": "holds '/'",
    "/etc/passwd": "holds '/'",
    "..\\evil": r"holds '\\'",
    "C:evil": "holds ':'",
    "what?": "holds '?'",
    "a\x1b[2J": "holds '\\x1b'",
    "a\u202eb": "holds '\\u202e'",
    "..": "begins or ends with a dot",
    ".hidden": "begins or ends with a dot",
    "end.": "begins or ends with a dot",
    " a": "begins or ends with a dot or a space",
    "NUL": "is that of a device",
    "com1.csv": "is that of a device",
    67 * "\N{EURO SIGN}": "has 67 characters, where files have at most 200 bytes",
}
SCALAR = Variant("scalar_rgb", "", None)


@pytest.mark.parametrize(("name", "fault"), REFUSED.items())
def test_a_name_that_no_file_can_have_is_refused(name, fault):
    with pytest.raises(InputError) as raised:
        check_file_names(["n01", name], what="probing")
    assert fault in str(raised.value)
    assert "use letters, digits" in str(raised.value)
    assert file_stems([name], kind="probing") == ["probing-1"]


@pytest.mark.parametrize(
    "names", [["n01", "n01"], ["a", "A"], ["stra\xdfe", "STRASSE"], ["\xe9", "e\u0301"], ["Rest"]]
)
def test_two_names_of_one_file_are_refused(names):
    with pytest.raises(InputError, match=r"probing .*: there are files named .* already"):
        check_file_names(names, what="probing", taken=["rest"])


def test_names_as_people_give_them_are_taken():
    check_file_names(
        ["n01", "push 3 (left)", "0.5 N", "\xfc-1_2", "common", "con-1"], what="probing"
    )


def _quoted(name):
    """As TOML writes it."""
    return '"' + "".join(f"\\U{ord(c):08x}" for c in name) + '"'


@pytest.mark.parametrize("name", ["../../evil", "NUL", ".hidden", 201 * "x"])
def test_a_session_and_a_bench_with_such_a_name_are_refused_where_they_are_read(
    cube_session, tmp_path, name
):
    for file, text, read in (
        (cube_session / "session.toml", (cube_session / "session.toml").read_text(), read_session),
        (tmp_path / "bench.toml", HALF_BALL, read_lab_config),
    ):
        file.write_text(text.replace('name = "n01"', f"name = {_quoted(name)}"))
        with pytest.raises(RecordError, match="files are named after it") as raised:
            read(file)
        assert file.name in str(raised.value)


def test_a_rig_with_a_camera_that_leads_elsewhere_is_refused(tmp_path):
    planned_session(tmp_path)
    file = tmp_path / "rig.toml"
    file.write_text(file.read_text().replace('"c1"', '"x/../../c1"'))
    with pytest.raises(CalibrationError, match=r"rig.toml: camera 'x/../../c1': files are named"):
        read_rig(file)


@pytest.mark.parametrize("name", ["rest", "Rest", "n01_1"])
def test_no_probing_overwrites_the_pictures_at_rest_or_another_one_s(tmp_path, name):
    """The first probing has two steps, the first of which is `n01_1`."""
    (tmp_path / "bench.toml").write_text(
        f'{HALF_BALL}[[probe]]\nname = "{name}"\npoint = [0, 0, 0.04]\ndepth = 1e-3\n'
    )
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(InputError, match=f"probing '{name}': there are files named"):
        make_session(read_lab_config(tmp_path / "bench.toml"), out, variant=SCALAR)
    assert not list(out.iterdir())


def test_names_of_probings_and_cameras_do_not_meet_in_one_picture(tmp_path):
    """`n01` seen by `b_c` and `n01_b` seen by `c` would both be n01_b_c.png."""
    text = SESSION.replace('"n02"', '"n01_b"')
    session = read_session(planned_session(tmp_path, text), observations=False)
    rig = read_rig(session.rig)
    cameras = zip(rig.cameras, ("c", "b_c", "d"), strict=True)
    renamed = Rig(tuple(replace(camera, name=name) for camera, name in cameras), 0, "here")
    with pytest.raises(InputError, match="picture 'n01_b_c': there are files named"):
        facility.check_picture_names([probing.name for probing in session.probings], renamed)


def test_a_plan_does_not_overwrite_its_pictures_at_rest(tmp_path):
    folder = planned_session(tmp_path, SESSION.replace('"n02"', '"rest"'))
    session = read_session(folder, observations=False)
    still, material = [0.0 * session.mesh.vertices] * 2, Material(5e4, 0.3)
    with pytest.raises(InputError, match="probing 'rest': there are files named 'rest' already"):
        next(planned_pictures(session, still, material=material, variant=SCALAR))


@pytest.mark.parametrize("name", ["../evil", "/tmp/evil", "a/../../evil"])
def test_a_file_that_somebody_else_named_stays_in_its_folder(tmp_path, name):
    """Files that come from a worker, or from the checkpoint of an interrupted run."""
    said = f"{re.escape(name)}: leads out of the folder"
    with pytest.raises(RecordError, match=said):
        path_below(tmp_path, name)
    bench = SimpleNamespace(folder=tmp_path / "out", measured=[])
    with pytest.raises(RecordError, match=said):
        facility._Bench.record(bench, ({name: b"x"}, ({}, {})))
    assert path_below(tmp_path, "images/n01_c0.png") == tmp_path / "images" / "n01_c0.png"
