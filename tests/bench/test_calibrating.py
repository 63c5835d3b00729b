"""A bench without a rig: the board, the object over the pictures, and what goes wrong there."""

import re
from pathlib import Path

import numpy as np
import pytest
from bench.drawn_world import Script, drawn_body, small_config

from palpate.bench import DeviceError, measure, virtual_bench
from palpate.bench.calibrating import _Places, _still_pictures, calibrate_live, moved_rig
from palpate.bench.questions import motion_about
from palpate.calibration import Charuco, Chessboard
from palpate.records import make_pose, read_rig, read_rig_covariance, read_session
from palpate.vision import calibration_numbers, project, triangulate

BOARD = Charuco(9, 7, 0.012, 0.009)


def bench():
    return virtual_bench(small_config(), draw=drawn_body, board=BOARD)


def off(rig, world):
    """How far from its place the object is seen, rms over cameras and vertices [px]."""
    points = small_config().specimen.mesh.vertices
    gaps = [project(a, points) - project(b, points)
            for a, b in zip(rig.cameras, world.rig.cameras, strict=True)]  # fmt: skip
    return float(np.sqrt(np.mean(np.square(gaps)) * 2.0))


@pytest.mark.slow
def test_from_a_board_to_constants(tmp_path):
    """Three answers before the pushes, and as good constants as with the rig known."""
    virtual = bench()
    script = Script(("Does the outline", "no"), ("By how much", "0.2 0 0.3 0 0 0"))
    estimate = measure(virtual, script, tmp_path, pushes=1)
    outline = f"Does the outline in {tmp_path / 'object.png'} lie on the object?"
    assert [text for text in script.asked if "By how much" not in text] == [
        "Lay the board where the object will stand, in view of all cameras",
        "Put the object there, as it will be pressed, and hands out of the pictures",
        outline, "Fit it to the pictures from there?", outline,
    ]  # fmt: skip
    # A twentieth of a pixel was measured; the nudge alone was 0.9 pixels; turned, a
    # half ball would stay: its shape does not tell.
    assert off(read_rig(tmp_path / "rig.toml"), virtual.cameras[0]._world) < 0.15
    known = read_rig_covariance(tmp_path / "rig_covariance.npz")
    assert {"c0.fx", "c1.tx", "c2.rz"} <= set(known.names)
    material = small_config().material
    # As in the test with a known rig; one push has 4 % (1 sigma).
    assert estimate.young_modulus.value == pytest.approx(material.young_modulus, rel=0.15)
    # Gone on with, nothing is asked again.
    again = Script()
    measure(bench(), again, tmp_path, dry_run=True)
    assert again.asked == []
    # The object is moved by 2 mm meanwhile, for good: a session of the new place begins.
    moved, script = bench(), Script(("Is it back", "no"))
    body, shift = moved.cameras[0]._world.body, np.array([2e-3, 0.0, 0.0])
    object.__setattr__(body, "vertices", body.vertices + shift)
    measure(moved, script, tmp_path, pushes=2)
    further = tmp_path.with_name(f"{tmp_path.name}-2")
    assert any(f"stay in {tmp_path}; {further} begins" in text for text in script.told)
    assert script.told[-1] == f"Session in {further}; a report: palpate fit {further}"
    assert [len(read_session(folder).probings) for folder in (tmp_path, further)] == [1, 2]
    rig = read_rig(further / "rig.toml")
    assert off(moved_rig(rig, make_pose(np.eye(3), -shift)), moved.cameras[0]._world) < 0.15


@pytest.mark.slow
def test_a_board_is_shown_until_lengths_are_known(tmp_path):
    """It ends with the first place after which the covariance will do, whatever corners of the
    pictures no board was in; the true cameras, and lengths on the object, are within it."""
    virtual, script = bench(), Script()
    calibrate_live(virtual, script, tmp_path)
    said = [text for text in script.told if "lengths are known to" in text]
    known_to = [float(re.search(r"known to ([\d.]+) %", text)[1]) for text in said]
    assert known_to[-1] <= 0.1 < min(known_to[:-1])
    assert len(list((tmp_path / "boards" / "c0").iterdir())) < 9
    folder, rig = tmp_path / "calibration", virtual.cameras[0]._world.rig
    found, known = read_rig(folder / "rig.toml"), read_rig_covariance(folder / "rig_covariance.npz")
    off = known.value - calibration_numbers(rig.cameras, known.names)
    # One by one: lens terms go together, and what is left of them is not linear. Normal errors
    # exceed four standard deviations in one of 39 once in four hundred draws.
    assert np.abs(off / np.sqrt(np.diag(known.covariance))).max() < 4.0
    points = small_config().specimen.mesh.vertices
    pixels = np.stack([project(camera, points) for camera in rig.cameras])
    measured = triangulate(found, pixels, 1.0).point
    x, y = points - points.mean(axis=0), measured - measured.mean(axis=0)
    stretch = np.linalg.svd(np.linalg.lstsq(x, y, rcond=None)[0])[1] - 1.0
    # The largest of three stretches is within three standard deviations of the worst direction.
    assert np.abs(stretch).max() < 3e-2 * known_to[-1]


@pytest.mark.slow
def test_a_calibration_is_gone_on_with_after_a_camera_failed(tmp_path):
    virtual, shots = bench(), []
    grab = virtual.cameras[1].grab

    def failing():
        shots.append(1)
        if len(shots) == 60:
            raise DeviceError("camera 'c1': it has stopped sending")
        return grab()

    virtual.cameras[1].grab = failing
    script = Script()
    with pytest.raises(DeviceError):
        calibrate_live(virtual, script, tmp_path)
    remaining = sorted(path.name for path in (tmp_path / "boards" / "c1").iterdir())
    # Places of 0.8 s at 15 pictures a second: the sixth was in hand.
    assert remaining == ["01.png", "02.png", "03.png", "04.png", "table.png"]
    # The process ended while a place was being written.
    (tmp_path / "boards" / "c2" / "04.png").unlink()
    calibrate_live(virtual, script, tmp_path)
    assert sum(text.startswith("Lay the board") for text in script.asked) == 1
    assert (tmp_path / "calibration" / "views.csv").read_text().count("c1,01,") == 1


def test_a_board_that_moves_is_not_taken(tmp_path):
    """By a pixel in each picture, then still: the pictures are those of half a second later."""
    virtual = bench()
    still, camera = virtual.cameras[0]._world._board, virtual.cameras[0]
    world, moves = camera._world, 12
    drawn = still(world.shown, 1)
    world._board = lambda board, number: tuple(
        np.roll(picture, min(int(15.0 * world.time), moves), axis=1) for picture in drawn
    )
    # Drawn anew for every picture.
    picture = world.picture

    def anew(number):
        world._drawn = None
        return picture(number)

    world.picture = anew
    places = _Places(tmp_path / "boards", BOARD, [device.name for device in virtual.cameras])
    _still_pictures(virtual, Script(), places)
    assert world.time > moves / 15.0 + 0.5
    # With the board still from the beginning it takes half a second.
    moves, world.time, camera._last = 0, 0.0, -1.0
    for device in virtual.cameras:
        device._last = -1.0
    _still_pictures(virtual, Script(), places)
    assert world.time < 0.7


def test_a_board_that_nobody_described_is_asked_for(tmp_path, monkeypatch):
    class Enough(Exception):
        pass

    class Asked(Script):
        def wait(self, text):
            raise Enough

    virtual = bench()
    object.__setattr__(virtual, "board", None)
    for kind, answers, board in (
        ("charuco", ["9 7 12mm", "9 7 12 9", "9 7 12mm 9mm"], BOARD),
        ("chessboard", ["2 6 20mm", "9 6 20mm"], Chessboard(9, 6, 0.02)),
    ):
        script = Asked(("What kind", kind), *(("Columns", answer) for answer in answers))
        seen_boards = []

        def places(self, _folder, board, _cameras, seen_boards=seen_boards):
            seen_boards.append(board)

        monkeypatch.setattr("palpate.bench.calibrating._Places.__init__", places)
        monkeypatch.setattr("palpate.bench.calibrating._Places.has_table", False)
        with pytest.raises(Enough):
            calibrate_live(virtual, script, tmp_path)
        np.testing.assert_allclose(seen_boards[0].points, board.points)
        assert len(script.told) == len(answers) - 1
        assert all(text.startswith("answer: board") for text in script.told), script.told


def test_a_nudge_turns_about_the_middle_of_the_object():
    mesh = small_config().specimen.mesh
    script = Script(
        ("Does", "no"), ("By how much", "1 2"), ("By how much", "1 0 0 0 0 nan"),
        ("By how much", "0 0 2.5 0 0 90"),
    )  # fmt: skip
    world = bench().cameras[0]._world
    motion = script.over(world.rig, mesh, Path("object.png"))
    assert len(script.told) == 2
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    moved = motion[:3, :3] @ middle + motion[:3, 3]
    np.testing.assert_allclose(moved - middle, [0.0, 0.0, 2.5e-3], atol=1e-15)
    np.testing.assert_allclose(motion[:3, :3] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)
    # A camera sees the object in its frame as it saw the moved one before.
    before, after = world.rig, moved_rig(world.rig, motion)
    points = mesh.vertices @ motion[:3, :3].T + motion[:3, 3]
    np.testing.assert_allclose(
        project(after.cameras[1], mesh.vertices), project(before.cameras[1], points), atol=1e-8
    )
    np.testing.assert_allclose(motion_about(mesh, np.zeros(3), np.eye(3)), np.eye(4))
