"""`palpate import`: from a program's file to a session that can be fitted, or to nothing at all."""

import numpy as np
import pytest
from fault_injection import in_child
from program_files import (
    DICE_NAMES,
    dice_states,
    dice_values,
    multidic_states,
    write_exodus,
    write_mat,
    write_table,
)
from surfaces import box

from palpate.app.cli import main
from palpate.geometry import write_mesh
from palpate.records import observed_rows, read_session
from palpate.records.files.displacement import read_displacement

VIC3D = "x,y,sigma,X,Y,Z,U,V,W"
# The frame of the program: 300 mm below the cube's origin, turned by 90 degrees about z.
POSE = 'length_unit = "mm"\nR = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]\nt = [0, 0, -300]\n'
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture
def bare(cube_session):
    """The session of a cube without displacements, in millimetres, with three probings."""
    file = cube_session / "session.toml"
    text = file.read_text().replace('displacement = "n01.csv"\n', "")
    probing = text[text.index("[[probe]]") :]
    text += "# the others\n" + probing.replace("n01", "n02") + probing.replace("n01", "n03")
    file.write_text(text)
    (cube_session / "n01.csv").unlink()
    return cube_session


@pytest.fixture
def top():
    """Points of the cube's upper face and their displacements [m]; the last one failed."""
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(0.0, 0.04, size=(30, 2)), np.full(30, 0.04)])
    return points, 1e-4 * rng.normal(size=(30, 3))


def _vic3d(path, top, *, turned=False):
    """A VIC-3D file [mm] of the points, in the frame of POSE where they are to be turned."""
    points, moved = 1e3 * top[0], 1e3 * top[1]
    if turned:
        points, moved = (points + np.array([0.0, 0.0, 300.0])) @ TURN, moved @ TURN
    sigma = np.full(30, 0.01)
    sigma[-1] = -1.0
    return write_table(path, VIC3D, np.column_stack([points[:, :2], sigma, points, moved]))


def _tree(folder):
    return {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_two_files_become_the_displacements_of_two_probings(palpate, bare, top, tmp_path):
    before = (bare / "session.toml").read_text()
    _vic3d(tmp_path / "n01.csv", top)
    _vic3d(tmp_path / "n03.csv", (top[0], 2.0 * top[1]))
    code, out, err = palpate("import", "vic3d", "n01.csv", "n03.csv", bare)
    assert (code, err) == (0, "")
    session = read_session(bare, probes=["n01", "n03"])
    first, third = (probing.displacement for probing in session.probings)
    # Written in metres with all digits: a rounding or two of the conversion.
    np.testing.assert_allclose(first.points, top[0], rtol=1e-15)
    np.testing.assert_allclose(first.displacement[:-1], top[1][:-1], rtol=1e-15)
    np.testing.assert_allclose(third.displacement[:-1], 2.0 * top[1][:-1], rtol=1e-15)
    assert list(np.flatnonzero(~observed_rows(first))) == [29]
    line = 'displacement = "n01.csv"'
    lines = (bare / "session.toml").read_text().splitlines()
    assert [x for x in lines if x not in (line, line.replace("1", "3", 1))] == before.splitlines()
    assert f"probing 'n01': {line}" in out
    assert "Note (2 of 2 files): It does not say its unit of length; mm was taken" in out
    row = next(x.split() for x in out.splitlines() if x.split()[:1] == ["n01"])
    assert row[2:8] == ["30", "29", "1", "0", "0", "0"]


def test_the_pose_takes_points_to_the_object(palpate, bare, top, tmp_path):
    (tmp_path / "pose.toml").write_text(POSE)
    file = _vic3d(tmp_path / "B0001.csv", top, turned=True)
    code, _, err = palpate("import", "vic3d", file, bare, "--probe", "n02")
    assert code == 2
    assert "the frame of the program is not the object's" in err
    options = ("--probe", "n02", "--to-object", "pose.toml")
    assert palpate("import", "vic3d", file, bare, *options)[0] == 0
    field = read_session(bare, probes=["n02"]).probings[0].displacement
    # 300 mm to one rounding in the file.
    np.testing.assert_allclose(field.points, top[0], atol=1e-15)
    np.testing.assert_allclose(field.displacement[:-1], top[1][:-1], atol=1e-18)


def test_units_of_the_session_are_used(palpate, bare, top, tmp_path):
    file = bare / "session.toml"
    file.write_text(
        file.read_text()
        .replace('length_unit = "m"', 'length_unit = "cm"')
        .replace("[0.02, 0.02, 0.04], radius = 0.006", "[2, 2, 4], radius = 0.6")
    )
    mesh = (bare / "mesh.ply").read_bytes()
    head, _, body = mesh.partition(b"end_header\n")
    count = int(head.split(b"element vertex ")[1].split()[0])
    points = np.frombuffer(body, "<f8", 3 * count) * 100.0
    (bare / "mesh.ply").write_bytes(head + b"end_header\n" + points.tobytes() + body[24 * count :])
    assert palpate("import", "vic3d", _vic3d(tmp_path / "n01.csv", top), bare)[0] == 0
    field = read_session(bare, probes=["n01"]).probings[0].displacement
    np.testing.assert_allclose(field.points, top[0], rtol=1e-14)
    np.testing.assert_allclose(field.displacement[:-1], top[1][:-1], rtol=1e-14)


def test_states_of_one_file_for_several_probings(palpate, bare, tmp_path):
    states = multidic_states()
    on_top = np.array([10.0, 10.0, 40.0]) - states[0][0]
    flat = [state * [1.0, 1.0, 0.0] + on_top * [1, 1, 0] + [0, 0, 40.0] for state in states]
    file = write_mat(tmp_path / "a.mat", "DIC3D", flat, version="7.3")
    options = ("--probe", "n01", "n02", "--frame", "1", "-1")
    code, out, _ = palpate("import", "duodic", file, bare, *options)
    assert code == 0
    # One by one: a session that says the same twice is refused.
    sessions = [read_session(bare, probes=[name]) for name in ("n01", "n02")]
    fields = [session.probings[0].displacement for session in sessions]
    np.testing.assert_allclose(2.0 * fields[0].displacement, fields[1].displacement, atol=1e-17)
    # The point that failed at rest has no place.
    assert len(fields[0].points) == 3
    assert next(x.split() for x in out.splitlines() if "n02" in x)[2:8] == [
        "4",
        "3",
        "0",
        "0",
        "0",
        "1",
    ]


def test_points_that_are_not_of_the_object(palpate, bare, top, tmp_path):
    points, moved = top[0].copy(), top[1]
    points[:4, 2] += 0.02
    file = _vic3d(tmp_path / "n01.csv", (points, moved))
    code, _, err = palpate("import", "vic3d", file, bare)
    assert code == 2
    assert "4 of 29 measured points lie farther than" in err
    code, out, _ = palpate("import", "vic3d", file, bare, "--drop-off-surface")
    assert code == 0
    row = next(x.split() for x in out.splitlines() if x.split()[:1] == ["n01"])
    assert row[2:8] == ["30", "25", "1", "0", "0", "4"]


def test_out_leaves_the_session_as_it_is(palpate, bare, top, tmp_path):
    before = _tree(bare)
    file = _vic3d(tmp_path / "n01.csv", top)
    code, out, _ = palpate("import", "vic3d", file, bare, "--out", "found")
    assert code == 0
    assert _tree(bare) == before
    assert sorted(_tree(tmp_path / "found")) == ["contents.txt", "inputs.txt", "n01.csv"]
    assert "Add to probing 'n01': displacement = \"../found/n01.csv\"" in out


def test_existing_displacements_need_leave(palpate, bare, top, tmp_path):
    file = _vic3d(tmp_path / "n01.csv", top)
    assert palpate("import", "vic3d", file, bare)[0] == 0
    before = _tree(bare)
    code, _, err = palpate("import", "vic3d", file, bare)
    assert code == 2
    assert "the probing 'n01' already has displacement = \"n01.csv\"; use --replace" in err
    assert _tree(bare) == before
    _vic3d(file, (top[0], 3.0 * top[1]))
    assert palpate("import", "vic3d", file, bare, "--replace")[0] == 0
    field = read_session(bare, probes=["n01"]).probings[0].displacement
    np.testing.assert_allclose(field.displacement[0], 3.0 * top[1][0], rtol=1e-15)
    # It may have been the only copy of a measurement.
    assert before.items() - _tree(bare).items() == {("session.toml", before["session.toml"])}
    assert palpate("import", "vic3d", file, bare, "--replace")[0] == 0
    assert sorted(set(_tree(bare)) - set(before)) == ["n01_2.csv"]


def test_a_file_that_happens_to_be_there_is_not_replaced(palpate, bare, top, tmp_path):
    (bare / "n01.csv").write_text("mine")
    code, out, _ = palpate("import", "vic3d", _vic3d(tmp_path / "n01.csv", top), bare)
    assert code == 0
    assert "probing 'n01': displacement = \"n01_2.csv\"" in out
    assert (bare / "n01.csv").read_text() == "mine"
    assert read_session(bare, probes=["n01"]).probings[0].displacement is not None


def test_another_probings_displacement_is_not_replaced(palpate, bare, top, tmp_path):
    file = _vic3d(tmp_path / "n01.csv", top)
    assert palpate("import", "vic3d", file, bare)[0] == 0
    session = bare / "session.toml"
    text = session.read_text()
    session.write_text(
        text.replace('"n01"', '"x"').replace('"n02"', '"n01"').replace('"x"', '"n02"')
    )
    before = (bare / "n01.csv").read_bytes()
    _vic3d(file, (top[0], 3.0 * top[1]))
    assert palpate("import", "vic3d", file, bare, "--probe", "n01", "--replace")[0] == 0
    assert (bare / "n01.csv").read_bytes() == before


def test_the_old_session_or_the_new_one_wherever_it_is_killed(palpate, bare, top, tmp_path):
    file = _vic3d(tmp_path / "n01.csv", top)
    assert palpate("import", "vic3d", file, bare)[0] == 0
    _vic3d(file, (top[0], 3.0 * top[1]))
    command = ["import", "vic3d", str(file), "--probe", "n01", "--replace"]
    before = _tree(bare)
    assert palpate(*command[:3], bare, *command[3:])[0] == 0
    after, step, outcome, seen = _tree(bare), 0, None, []
    while outcome != "done":
        # Every third step: the steps of a change have a test of their own.
        step += 3
        folder = tmp_path / f"session{step}"
        folder.mkdir()
        for name, content in before.items():
            (folder / name).write_bytes(content)
        words = [*command[:3], str(folder), *command[3:]]
        outcome = in_child(lambda words=words: main(words), folder, step=step)
        read_session(folder, probes=["n01"])
        visible_files = {name: content for name, content in _tree(folder).items() if name[0] != "."}
        # The new file may be there before the session names it.
        assert visible_files in (before, before | {"n01_2.csv": after["n01_2.csv"]}, after)
        seen.append(visible_files)
    assert seen[0] == before
    assert seen[-1] == after
    assert len(seen) > 5


@pytest.mark.parametrize("kind", ["folder", "source"])
def test_nothing_that_is_there_is_touched(palpate, bare, top, tmp_path, kind):
    file = _vic3d((tmp_path if kind == "folder" else bare) / "n01.csv", top)
    if kind == "folder":
        (bare / "n01.csv").mkdir()
        (bare / "n01.csv" / "thesis").write_text("years of work")
    before = _tree(bare)
    assert palpate("import", "vic3d", file, bare)[0] == 0
    assert before.items() - _tree(bare).items() == {("session.toml", before["session.toml"])}
    assert read_session(bare, probes=["n01"]).probings[0].displacement is not None


def test_one_bad_file_of_two_leaves_nothing(palpate, bare, top, tmp_path):
    before = _tree(bare)
    _vic3d(tmp_path / "n01.csv", top)
    bad = _vic3d(tmp_path / "n02.csv", top)
    bad.write_text(bad.read_text().replace("0.01", "0.0.1", 1))
    code, _, err = palpate("import", "vic3d", "n01.csv", "n02.csv", bare)
    assert code == 2
    assert "n02.csv: line 2: column 'sigma' holds '0.0.1'; must be a number" in err
    assert _tree(bare) == before


def test_probings_in_one_line_are_edited_too(palpate, bare, top, tmp_path):
    file = bare / "session.toml"
    text = file.read_text()
    head = text[: text.index("[[probe]]")]
    line = (
        'probe = [{ name = "n01", force = [0, 0, -1], contact = { point = [0.02, 0.02, 0.04],'
        ' radius = 0.006, profile = "smooth" } }]\n'
    )
    file.write_text(line + head)
    assert palpate("import", "vic3d", _vic3d(tmp_path / "B1.csv", top), bare)[0] == 0
    edited = file.read_text()
    assert edited.endswith(head)
    assert edited.startswith(line[:-5])
    assert len(read_session(bare).probings[0].displacement.points) == 30


def test_a_byte_order_mark_and_line_ends_stay(palpate, bare, top, tmp_path):
    file = bare / "session.toml"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    assert palpate("import", "vic3d", _vic3d(tmp_path / "n01.csv", top), bare)[0] == 0
    content = file.read_bytes()
    assert content.startswith(b"\xef\xbb\xbfformat")
    assert content.count(b"\n") == content.count(b"\r\n")
    assert read_session(bare, probes=["n01"]).probings[0].displacement is not None


def test_a_name_that_is_no_file_name(palpate, bare, top, tmp_path):
    file = bare / "session.toml"
    file.write_text(file.read_text().replace('"n02"', '"top/left"'))
    source = _vic3d(tmp_path / "n01.csv", top)
    code, _, err = palpate("import", "vic3d", source, bare, "--probe", "top/left")
    assert code == 2
    assert "probing 'top/left': files are named after it, and its name holds '/'" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("vic3d", "cube"), "give the result files and then the session, before the options"),
        (("vic3d", "n01.csv", "--probe", "n01", "cube"), "give the result files and then the"),
        (("vic3d", "n01.csv", "n02.csv"), "n02.csv: is no session; name its folder"),
        (("gom", "n01.csv", "cube"), "gom"),
        (("vic3d", "n01.csv", "cube", "--length-unit", "km"), "km"),
        (("vic3d", "n01.csv", "cube", "--to-object", "none.toml"), "none.toml: cannot be read"),
        (("vic3d", "none.csv", "cube", "--probe", "n01"), "none.csv: cannot be read"),
    ],
)
def test_wrong_arguments(palpate, bare, top, tmp_path, arguments, message):
    _vic3d(tmp_path / "n01.csv", top)
    before = _tree(bare)
    code, _, err = palpate("import", *arguments)
    assert code == 2
    assert message in err
    assert _tree(bare) == before


def test_what_is_not_believed_is_counted_by_cause(palpate, bare, tmp_path):
    """Of a smooth field: one failed, two that hardly correlate, one that moves on its own."""
    rng = np.random.default_rng(4)
    position = np.column_stack([rng.uniform(1.0, 39.0, size=(200, 2)), np.full(200, 40.0)])
    moved = position * [1e-3, -5e-4, -2e-2] + rng.normal(scale=1e-3, size=(200, 3))
    moved[17, 0] += 0.1
    match, gamma = np.zeros(200), np.full(200, 0.02)
    match[3], gamma[5], gamma[8] = -1.0, 0.6, 1.9
    names = [*DICE_NAMES[:3], *DICE_NAMES[4:7], "MATCH", "GAMMA"]
    rows = np.column_stack([position, moved, match, gamma])
    write_table(tmp_path / "n01.txt", ",".join(names), rows)
    code, out, _ = palpate("import", "dice", "n01.txt", bare)
    assert code == 0
    row = next(x.split() for x in out.splitlines() if x.split()[:1] == ["n01"])
    assert row[2:8] == ["200", "196", "4", "2", "1", "0"]
    field = read_session(bare, probes=["n01"]).probings[0].displacement
    assert list(np.flatnonzero(~observed_rows(field))) == [3, 5, 8, 17]
    again = ("import", "dice", "n01.txt", bare, "--replace", "--min-score", "0.7")
    assert palpate(*again)[0] == 0
    field = read_session(bare, probes=["n01"]).probings[0].displacement
    assert list(np.flatnonzero(~observed_rows(field))) == [3, 8, 17]


def test_dice_text_and_exodus_agree(palpate, bare, tmp_path):
    values, states = dice_values(), dice_states()
    position = np.column_stack([np.arange(4.0) * 10.0, np.full(4, 20.0), np.full(4, 40.0)])
    values[:, :3] = position
    states[:, :3] = position.T
    write_table(tmp_path / "n01.txt", ",".join(DICE_NAMES), values)
    write_exodus(tmp_path / "n02.e", states, form="large")
    assert palpate("import", "dice", "n01.txt", "n02.e", bare)[0] == 0
    # One by one: a session that says the same twice is refused.
    sessions = [read_session(bare, probes=[name]) for name in ("n01", "n02")]
    fields = [session.probings[0].displacement for session in sessions]
    np.testing.assert_array_equal(fields[0].displacement, fields[1].displacement)
    assert list(observed_rows(fields[0])) == [True, True, True, False]


def test_real_results_of_dice(palpate, bare, shared_data, tmp_path):
    """A flat specimen in DICe's own plane frame: the top of a block below z = 0."""
    # Points from -25 to 69 mm, -25 to 25 mm; DICe's plane is z = 0.
    block = box(size=(0.12, 0.08, 0.02), cells=6, origin=(-0.04, -0.04, -0.02))
    write_mesh(bare / "mesh.ply", block)
    gold = shared_data / "real" / "gt4_dspec" / "dice_gold" / "DICe_solution.e"
    code, out, _ = palpate("import", "dice", gold, bare, "--probe", "n01", "--out", "found")
    assert code == 0
    row = next(x.split() for x in out.splitlines() if x.split()[:1] == ["n01"])
    # Its README: four of the 123 subsets failed; they have a place.
    assert row[2:8] == ["123", "119", "4", "0", "0", "0"]
    # The specimen is flat to 28 um.
    assert float(row[8]) < 0.028
    field, _ = read_displacement(tmp_path / "found" / "n01.csv", block)
    assert observed_rows(field).sum() == 119
