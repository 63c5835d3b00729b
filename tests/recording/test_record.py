"""From two small videos, a force log and a log of poses to a session."""

import shutil
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest
from recording.bench_footage import OFFSETS, PEAKS, RATE, SIZE, picture, texture, write_recording
from recording.bench_signals import DIRECTION, HOLD, RAMP, begins, push

from palpate.app.cli import main
from palpate.errors import RecordError
from palpate.recording import find_presses, read_recording, write_recorded
from palpate.recording.footage import Footage, camera_motion
from palpate.recording.record import read_poses
from palpate.records import folder_changes, read_session


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three presses, two cameras, three axes of force."""
    return write_recording(tmp_path_factory.mktemp("recording") / "bench")


@pytest.mark.parametrize(
    ("contact", "radius"),
    [
        ("radius = 0.004", 0.004),
        ("radius = [0.004, 0.003, 0.002]", 0.003),
        # A ball touches a circle of half its radius, or so.
        ('tool = "sphere"\ntool_radius = 0.006', 0.003),
        ('tool = "sphere"\ntool_radius = "8 mm"', 0.004),
        # A twentieth of the block's 60 mm.
        ("", 0.003),
    ],
)
def test_radius_of_the_search(recording: Path, tmp_path: Path, contact: str, radius: float) -> None:
    folder = tmp_path / "bench"
    shutil.copytree(recording, folder)
    text = (folder / "recording.toml").read_text()
    start = text.index("[contact]") + len("[contact]\n")
    (folder / "recording.toml").write_text(text[:start] + contact)
    given = read_recording(folder)
    assert given.search_radius(2) == pytest.approx(radius, rel=1e-12)


def test_presses_clocks_and_forces(recording: Path) -> None:
    recorded = find_presses(read_recording(recording))
    assert [press.name for press in recorded.presses] == ["n01", "n02", "n03"]
    for clock, offset in zip(recorded.clocks, OFFSETS, strict=True):
        # Asked for are 5 ms of frames that are 50 ms apart; the presses' scatter says 0.2 ms.
        assert abs(clock.offset - offset) < 1e-3
    for press, peak, begin in zip(recorded.presses, PEAKS, begins(3), strict=True):
        assert np.linalg.norm(press.reading.force - peak * DIRECTION) < 0.005 * peak
        assert begin + 0.9 * RAMP < press.reading.begin < press.reading.end < begin + RAMP + HOLD
        # The tool is in the picture from half a second before it touches.
        assert press.rest[1] < begin - 0.45
    assert [motion.dropped for motion in recorded.motions] == [0, 0]


def test_the_command_writes_a_session(
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["record", str(recording), "--out", "session"]) == 0
    said = capsys.readouterr()
    assert "3 of 3 presses" in said.out
    folder = tmp_path / "session"
    session = read_session(folder)
    assert session.name == "block"
    assert [probing.name for probing in session.probings] == ["n01", "n02", "n03"]
    for probing, peak in zip(session.probings, PEAKS, strict=True):
        error = probing.force - peak * DIRECTION
        assert probing.force_std is not None
        assert np.abs(error / probing.force_std).max() < 4.0
        assert probing.contact.radius == 0.004
    rest, loaded = (
        cv2.imread(str(folder / "images" / f"n02{name}_c0.png"), cv2.IMREAD_GRAYSCALE).astype(float)
        for name in ("_rest", "")
    )
    rng = np.random.default_rng(7)
    for seen, share, tool in ((rest, 0.0, -1.0), (loaded, PEAKS[1] / PEAKS.max(), 60.0)):
        # Noise of 1.5 in the picture that is drawn here, of a third of that in a mean of eight.
        off = seen - picture(texture(0), share, tool, rng)
        assert np.sqrt((off**2).mean()) < 1.8
    table = np.genfromtxt(folder / "presses.csv", delimiter=",", names=True, dtype=None)
    np.testing.assert_array_equal(table["press"], [1, 2, 3])
    assert (folder / "recording.png").stat().st_size > 10_000
    assert folder_changes(Path("session"))[1] == {}
    assert main(["check", "session"]) == 0


@pytest.mark.slow
def test_frames_that_were_dropped_are_counted_and_bridged(recording: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bench"
    shutil.copytree(recording, folder)
    # Seven frames are missing from the pictures, not from the times.
    capture = cv2.VideoCapture(str(recording / "c0.avi"))
    (folder / "c0").mkdir()
    times, k = [], 0
    while (read := capture.read())[0]:
        if k not in (67, 68, 69, 167, 200, 201, 267):
            cv2.imwrite(str(folder / "c0" / f"{k:05d}.png"), read[1])
            times.append(k / RATE)
        k += 1
    (folder / "c0.csv").write_text("time\n" + "".join(f"{time:.6f}\n" for time in times))
    text = (folder / "recording.toml").read_text()
    given = 'pictures = "c0/*.png"\ntimes = "c0.csv"'
    (folder / "recording.toml").write_text(text.replace('video = "c0.avi"', given))
    recorded = find_presses(read_recording(folder))
    assert recorded.motions[0].dropped == 7
    assert abs(recorded.clocks[0].offset - OFFSETS[0]) < 1e-3
    assert len(recorded.presses) == 3
    assert any("7 frames were dropped" in note for note in recorded.notes)


@pytest.mark.slow
def test_a_log_of_poses_gives_contact_and_travel(recording: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bench"
    shutil.copytree(recording, folder)
    time = np.arange(0.0, 20.0, 0.01)
    # The tip stands on the surface and goes in by 1 mm a newton; its way to there is not seen.
    depth = 1e-3 * push(time, PEAKS)
    rows = np.column_stack([time, np.full_like(time, 0.002), np.zeros_like(time), -depth])
    np.savetxt(folder / "p.csv", rows, delimiter=",", header="time,x,y,z", comments="")
    text = (folder / "recording.toml").read_text()
    start = text.index("points")
    (folder / "recording.toml").write_text(f'{text[:start]}poses = "p.csv"\n')
    assert main(["record", str(folder), "--out", str(tmp_path / "s")]) == 0
    for probing, peak in zip(read_session(tmp_path / "s").probings, PEAKS, strict=True):
        assert probing.tip_displacement is not None
        assert probing.tip_displacement_std is not None
        off = probing.tip_displacement - [0.0, 0.0, -1e-3 * peak]
        # What the tip went before the force was noticed, and half of it is taken off.
        assert np.abs(off).max() < 4.0 * probing.tip_displacement_std[2] < 1e-4
        np.testing.assert_allclose(probing.contact.point[:2], [0.002, 0.0], atol=1e-9)
    text = (folder / "p.csv").read_text().splitlines()
    (folder / "p.csv").write_text("\n".join(text[:700]))
    recorded = find_presses(given := read_recording(folder))
    (tmp_path / "t").mkdir()
    with pytest.raises(RecordError, match="same clock"):
        write_recorded(tmp_path / "t", given, recorded)


@pytest.mark.slow
def test_a_long_hold_under_a_log_of_poses_is_written_as_a_series(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The bench's holds are about as long as its ramps.
    monkeypatch.setattr("palpate.recording.record._CREEPS", 0.5)
    folder = tmp_path / "bench"
    shutil.copytree(recording, folder)
    time = np.arange(0.0, 20.0, 0.01)
    rows = np.column_stack([time, 0.0 * time, 0.0 * time, -1e-3 * push(time, PEAKS)])
    np.savetxt(folder / "p.csv", rows, delimiter=",", header="time,x,y,z", comments="")
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(f'{text[: text.index("points")]}poses = "p.csv"\n')
    assert main(["record", str(folder), "--out", str(tmp_path / "s")]) == 0
    for probing, peak, begin in zip(
        read_session(tmp_path / "s").probings, PEAKS, begins(3), strict=True
    ):
        series = probing.series
        assert series is not None
        assert series.tip is not None
        # The log is averaged over bins of some hundredths of a second.
        assert series.contact == pytest.approx(begin, abs=0.1)
        # 95 % of a force that rises and settles smoothly.
        assert 0.7 * RAMP < series.rise < RAMP
        assert series.time[-1] < begin + RAMP + HOLD
        assert series.force[series.reference] == pytest.approx(peak, rel=0.01)
        assert series.tip[series.reference, 2] == pytest.approx(-1e-3 * peak, rel=0.02)
        assert np.isnan(series.tip[0]).all()


def test_memory_does_not_grow_with_the_video(recording: Path, tmp_path: Path) -> None:
    whole = read_recording(recording).footage[0]
    capture = cv2.VideoCapture(str(whole.video))
    short = tmp_path / "short.avi"
    writer = cv2.VideoWriter(str(short), cv2.VideoWriter_fourcc(*"FFV1"), RATE, SIZE)
    for _ in range(40):
        writer.write(capture.read()[1])
    writer.release()
    peaks = []
    for footage in (Footage("c0", short), whole):
        tracemalloc.start()
        motion = camera_motion(footage)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert len(motion.time) > 8 * 40
    # A frame is 58 kB of colours; what is kept of one are three numbers, 100 bytes as a list.
    assert peaks[1] - peaks[0] < 3 * 100 * len(motion.time)


@pytest.mark.parametrize(
    ("heading", "seconds", "metres"),
    [
        ("time,x,y,z", 1.0, 1e-2),
        ("t [ms],x,y,z", 1e-3, 1e-2),
        ("time [s],x [mm],y [mm],z [mm]", 1.0, 1e-3),
    ],
)
def test_units_of_headings_count(
    tmp_path: Path, heading: str, seconds: float, metres: float
) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(f"{heading}\n0,1,2,3\n4,5,6,7\n")
    poses = read_poses(path, metres_per_unit=1e-2)
    np.testing.assert_allclose(poses.time, [0.0, 4.0 * seconds], rtol=1e-12)
    np.testing.assert_allclose(poses.position[1], metres * np.array([5.0, 6.0, 7.0]), rtol=1e-12)


@pytest.mark.parametrize(
    ("heading", "says"),
    [
        ("time [min],x,y,z", r"'time \[min\]' is in 'min'; must be in one of s, ms, us, ns"),
        ("time,x [px],y [px],z [px]", r"is in 'px'; must be in one of um, mm"),
        ("time,x [mm],y [mm],z [m]", "different units"),
    ],
)
def test_other_units_are_refused(tmp_path: Path, heading: str, says: str) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(f"{heading}\n0,1,2,3\n4,5,6,7\n")
    with pytest.raises(RecordError, match=says):
        read_poses(path, metres_per_unit=1.0)
