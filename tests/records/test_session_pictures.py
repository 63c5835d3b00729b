"""Sessions of pictures: rigid-motion sequences, and probings whose displacement is yet to come."""

import pytest

from palpate.errors import InputError, RecordError
from palpate.records import Images, read_session
from palpate.records.session import Step, require_probings

STEPS = """\
[rig]
cameras = "rig.toml"

[[step]]
name = "s0"
images = "images/s0_{camera}.png"

[[step]]
name = "s1"
images = "images/s1_{camera}.png"
"""


@pytest.fixture
def steps_folder(session_folder):
    """The cube as a rigid-motion sequence, without support."""
    file = session_folder / "session.toml"
    head = file.read_text().partition("[support]")[0]
    file.write_text(head + STEPS)
    (session_folder / "rig.toml").write_text("")
    return session_folder


def test_a_rigid_motion_sequence_is_read_and_is_no_probing(steps_folder):
    session = read_session(steps_folder)
    assert session.steps == (
        Step("s0", "images/s0_{camera}.png"),
        Step("s1", "images/s1_{camera}.png"),
    )
    assert session.probings == ()
    assert len(session.held_triangles) == 0
    assert session.rig == steps_folder / "rig.toml"
    assert session.notes == ()
    with pytest.raises(InputError, match=r"session\.toml: this is a rigid-motion sequence"):
        require_probings(session)
    with pytest.raises(RecordError, match=r"no probing .* none, it is a rigid-motion sequence"):
        read_session(steps_folder, probes=["n01"])


def test_a_support_may_stay_in_a_rigid_motion_sequence(steps_folder):
    file = steps_folder / "session.toml"
    plane = "plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-6 }"
    file.write_text(file.read_text().replace("[rig]", f"[support]\n{plane}\n[rig]"))
    assert len(read_session(steps_folder).held_triangles) == 32
    file.write_text(file.read_text().replace("tolerance", "tolerence"))
    with pytest.raises(RecordError, match="did you mean 'tolerance'"):
        read_session(steps_folder)


BAD_STEPS = [
    ('name = "s1"', 'name = "s0"', "step 's0': there are files named 's0' already"),
    ('name = "s1"', "", r"\[\[step\]\] number 2: the key 'name' is missing"),
    ('name = "s1"', "name = 1", r"\[\[step\]\] number 2 name: is 1; must be a text"),
    ('images = "images/s1', 'image = "images/s1', "unknown key 'image'; did you mean 'images'"),
    ('images = "images/s1_{camera}.png"', "", r"\[\[step\]\] 's1': the key 'images' is missing"),
    ('"images/s1_{camera}.png"', '["a"]', r"\[\[step\]\] 's1' images: is \['a'\]; must be a text"),
    ("s1_{camera}", "s1_{cam}", r"'s1' images: 'images/s1_{cam}\.png' has no {camera}, so all cam"),
    ("s1_{camera}", "s0_{camera}", r"\[\[step\]\] 's1' images: 'images/s0_.* is named before"),
    (
        '[rig]\ncameras = "rig.toml"\n',
        "",
        "the steps have images, but no rig is given: the",
    ),
    ('"rig.toml"', '"rog.toml"', r"\[rig\] cameras: no such file: .*did you mean 'rig\.toml'"),
    ('cameras = "rig', 'camera = "rig', r"\[rig\]: unknown key 'camera'; did you mean 'cameras'"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD_STEPS)
def test_a_bad_step_is_told_where_and_what(steps_folder, old, new, message):
    file = steps_folder / "session.toml"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(RecordError, match=message) as caught:
        read_session(steps_folder)
    assert str(caught.value).startswith(str(file))


def test_one_step_is_no_motion(steps_folder):
    file = steps_folder / "session.toml"
    file.write_text(file.read_text().partition('[[step]]\nname = "s1"')[0])
    with pytest.raises(RecordError, match="the session has one step, 's0', alone; motion needs"):
        read_session(steps_folder)


IMAGES = 'images = { rest = "r_{camera}.png", loaded = ["a_{camera}.png", "b_{camera}.png"] }\n'


def test_images_are_kept_beside_displacements(edited):
    session = read_session(edited("force_std = 0.012\n", IMAGES))
    assert session.probings[0].images == Images(
        "r_{camera}.png", ("a_{camera}.png", "b_{camera}.png")
    )
    assert session.probings[0].displacement is not None
    require_probings(session)


def test_images_stand_in_for_displacements_where_the_cameras_are_known(edited):
    edited("force_std = 0.012\n", IMAGES)
    folder = edited('displacement = "n01.csv"\n', "")
    with pytest.raises(RecordError, match="'n01' has images, but no rig is given: the cam"):
        read_session(folder)
    (folder / "rig.toml").write_text("")
    session = read_session(edited("[[probe]]", '[rig]\ncameras = "rig.toml"\n[[probe]]'))
    first, second = session.probings
    assert first.displacement is None
    assert first.images.loaded[-1] == "b_{camera}.png"
    assert second.displacement is not None
    assert session.rig == folder / "rig.toml"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '["a_{camera}.png", "b_{camera}.png"]',
            '"a_{camera}.png"',
            r"images loaded: is 'a_{camera}.png'; mu",
        ),
        (
            '["a_{camera}.png", "b_{camera}.png"]',
            "[]",
            r"images loaded: is \[\]; must be a list of file",
        ),
        ('"b_{camera}.png"', "3", r"images loaded: is \['a_{camera}.png', 3\]; must be a list"),
        ('"b_{camera}.png"', '" "', "images loaded: is ' '; must not be empty"),
        ("b_{camera}", "b", r"images loaded: 'b\.png' has no {camera}"),
        ("r_{camera}", "r", r"images rest: 'r\.png' has no {camera}"),
        ("b_{camera}", "r_{camera}", r"images loaded: 'r_{camera}\.png' is named before; the same"),
        ("b_{camera}", "a_{camera}", r"images loaded: 'a_{camera}\.png' is named before; the same"),
        ("rest =", "rost =", "images: unknown key 'rost'; did you mean 'rest'"),
    ],
)
def test_bad_image_patterns_are_told_where_and_what(edited, old, new, message):
    edited("force_std = 0.012\n", IMAGES)
    with pytest.raises(RecordError, match=rf"\[\[probe\]\] 'n01' {message}"):
        read_session(edited(old, new))


def test_probings_and_steps_do_not_mix(session_folder):
    file = session_folder / "session.toml"
    head, _, probings = file.read_text().partition("[[probe]]")
    file.write_text(f"{head}{STEPS}\n[[probe]]{probings}")
    (session_folder / "rig.toml").write_text("")
    with pytest.raises(RecordError, match=r"2 probings and 2 steps .*; it must have one kind only"):
        read_session(session_folder)


def test_shared_sessions_of_pictures_are_read(shared_data):
    """Needs ../shared."""
    seen = read_session(shared_data / "halfball_images")
    assert [len(probing.images.loaded) for probing in seen.probings] == [1] * 4 + [5] + [1] * 12
    assert all(probing.displacement is None for probing in seen.probings)
    turned = read_session(shared_data / "rigid_rotation_z")
    assert [step.name for step in turned.steps] == [f"s{i}" for i in range(9)]
    assert turned.notes == ()
