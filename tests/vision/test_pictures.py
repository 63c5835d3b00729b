"""Pictures of a rig, picture files whole and damaged, and videos."""

import os
import resource
import struct
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate import machine
from palpate.errors import InputError, RecordError
from palpate.records import Camera, Rig
from palpate.vision import pictures
from palpate.vision.pictures import (
    claimed_size,
    decode_picture,
    read_pictures,
    video_frames,
)

GREY = np.random.default_rng(0).integers(3, 253, (12, 20), dtype=np.uint8)
KINDS = (".png", ".jpg", ".tif", ".bmp")
RAMP = np.arange(12 * 20, dtype=np.uint8).reshape(12, 20)
_SIZE = (64, 48)


def _rig(*, size=(20, 12), names=("c0", "c1")):
    matrix = np.array([[30.0, 0.0, 9.5], [0.0, 30.0, 5.5], [0.0, 0.0, 1.0]])
    cameras = [Camera(name, size, matrix, np.zeros(8), np.eye(4)) for name in names]
    return Rig(tuple(cameras), 0, "rig.toml")


def _encoded(pixels, kind=".png", *options):
    done, content = cv2.imencode(kind, pixels, list(options))
    assert done
    return content.tobytes()


@pytest.fixture
def written(tmp_path):
    """Function that writes one file for both cameras of the rig and gives the reading of it."""

    def write(content, *, suffix=".png", second=None, rig=None):
        (tmp_path / f"s3_c0{suffix}").write_bytes(content)
        (tmp_path / f"s3_c1{suffix}").write_bytes(content if second is None else second)
        rig = rig or _rig()
        return pictures.read_pictures(
            rig, f"s3_{{camera}}{suffix}", folder=tmp_path, what="step 's3'"
        )

    return write


def test_pictures_that_the_memory_cannot_hold_are_refused_at_the_first(written, monkeypatch):
    # 480 pixels of 100 bytes, and the second picture is not even there.
    monkeypatch.setattr(machine, "machine_memory", lambda: 50e3)
    with pytest.raises(
        InputError,
        match=r"^step 's3': 2 pictures .* would take 0\.0 MB of memory; .*: leave camera",
    ):
        written(_encoded(RAMP), second=b"")
    monkeypatch.setattr(machine, "machine_memory", lambda: 60e3)
    assert len(written(_encoded(RAMP)).grey) == 2


def _note(seen):
    (note,) = seen.notes
    return note


# ---------------------------------------------------------------- good ones


@pytest.mark.parametrize("kind", [".png", ".tif", ".bmp"])
def test_grey_levels_of_8_bits_are_kept(written, kind):
    seen = written(_encoded(GREY, kind), suffix=kind, second=_encoded(GREY[::-1], kind))
    np.testing.assert_array_equal(seen.grey[0], GREY.astype(np.float32))
    np.testing.assert_array_equal(seen.grey[1], GREY[::-1].astype(np.float32))
    assert seen.grey[0].dtype == np.float32
    assert seen.notes == ()
    assert seen.saturated == (0.0, 0.0)


def test_a_jpeg_is_read_as_it_decodes(written):
    smooth = cv2.GaussianBlur(GREY, (0, 0), 3.0)
    seen = written(_encoded(smooth, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 100), suffix=".jpg")
    # At the best quality a few levels remain.
    np.testing.assert_allclose(seen.grey[0], smooth, atol=3.0)
    progressive = _encoded(smooth, ".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    restarts = _encoded(smooth, ".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 1)
    written(progressive, suffix=".jpg", second=restarts)


@pytest.mark.parametrize("kind", [".png", ".tif"])
def test_16_bits_keep_their_resolution_and_it_is_said(written, kind):
    deep = GREY.astype(np.uint16) * 257 + np.arange(20, dtype=np.uint16)
    seen = written(_encoded(deep, kind), suffix=kind)
    np.testing.assert_allclose(seen.grey[0], deep / 257.0, rtol=1e-7)
    note = "step 's3', cameras c0, c1: grey levels of 16 bits were divided by 257 (65535 becomes"
    assert _note(seen).startswith(note)


def test_colours_become_luminance_and_it_is_said(written):
    colour = np.dstack([GREY, GREY[::-1], GREY[:, ::-1]])
    seen = written(_encoded(colour), second=_encoded(GREY))
    truth = colour.astype(float) @ [0.114, 0.587, 0.299]
    np.testing.assert_allclose(seen.grey[0], truth, rtol=1e-6)
    assert _note(seen).startswith("step 's3', camera c0: colours were turned into luminance")
    deep = written(_encoded(colour.astype(np.uint16) * 257))
    np.testing.assert_allclose(deep.grey[0], truth, rtol=1e-6)
    assert [note.split(": ")[1][:11] for note in deep.notes] == ["colours wer", "grey levels"]


def test_alpha_is_left_out_and_it_is_said(written):
    clear = np.dstack([GREY, GREY, GREY, np.zeros_like(GREY)])
    seen = written(_encoded(clear))
    np.testing.assert_allclose(seen.grey[0], GREY, rtol=1e-6)
    assert any("the alpha channel was left out" in note for note in seen.notes)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_floating_point_levels_are_kept_and_it_is_said(written, kind):
    levels = GREY.astype(kind) / 7.0 - 5.0
    seen = written(_encoded(levels, ".tif"), suffix=".tif")
    np.testing.assert_allclose(seen.grey[0], levels, rtol=1e-7)
    assert "floating-point grey levels were kept" in _note(seen)
    assert np.isnan(seen.saturated).all()


@pytest.mark.parametrize(
    ("scale", "share"),
    [(1, 0.1), (257, 0.1), (16, 0.0)],
)
def test_saturated_pixels_are_counted(written, scale, share):
    bright = GREY.copy()
    bright[:, 4:6] = 255
    kind = np.uint8 if scale == 1 else np.uint16
    seen = written(_encoded(bright.astype(kind) * kind(scale)), second=_encoded(GREY))
    assert seen.saturated == (pytest.approx(share), 0.0)


@pytest.mark.parametrize(("bits", "shift"), [(12, 0), (12, 4), (10, 0), (14, 2)])
def test_white_of_a_camera_of_fewer_bits_is_known(written, bits, shift):
    levels = np.minimum(GREY.astype(np.uint32) * 2 ** (bits - 7), 2**bits - 1)
    share = (levels == 2**bits - 1).mean()
    seen = written(_encoded((levels << shift).astype(np.uint16)))
    assert share > 0.2
    assert seen.saturated[0] == pytest.approx(share)


def test_a_saturated_colour_counts_once(written):
    colour = np.dstack([GREY, GREY, GREY])
    colour[0, :12] = [255, 10, 10]
    assert written(_encoded(colour)).saturated[0] == pytest.approx(0.05)


def _pages(count):
    done, pages = cv2.imencodemulti(".tif", [GREY, GREY[::-1], GREY[:, ::-1]][:count])
    assert done
    return pages.tobytes()


def test_a_smaller_copy_beside_a_picture_is_left_aside(written):
    """The tag that says what the second picture is for, as `imencodemulti` writes it."""
    content = bytearray(_pages(2))
    purpose = struct.pack("<HHII", 254, 4, 1, 2)
    assert content.count(purpose) == 2
    index = content.rindex(purpose)
    content[index : index + 12] = struct.pack("<HHII", 254, 4, 1, 1)
    seen = written(bytes(content), suffix=".tif")
    np.testing.assert_array_equal(seen.grey[0], GREY)


def test_any_size_will_do_where_the_rig_does_not_say(written):
    seen = written(_encoded(GREY), second=_encoded(GREY[:9, :7]), rig=_rig(size=None))
    assert [grey.shape for grey in seen.grey] == [(12, 20), (9, 7)]


def test_shared_pictures_are_read(shared_data):
    """Needs ../shared."""
    folder = shared_data / "rigid_translation_x"
    rig = _rig(size=(640, 480), names=("c0", "c1", "c2"))
    seen = pictures.read_pictures(rig, "images/s3_{camera}.png", folder=folder, what="step 's3'")
    assert [grey.shape for grey in seen.grey] == [(480, 640)] * 3
    assert seen.notes == ()


# ---------------------------------------------------------------- bad ones


def _refused(written, message, content, **options):
    with pytest.raises(RecordError, match=message) as caught:
        written(_encoded(GREY), second=content, **options)
    text = str(caught.value)
    assert text.startswith("step 's3', camera 'c1': ")
    assert "s3_c1" in text


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_cut_off_anywhere_is_refused(written, kind, capfd):
    content = _encoded(GREY, kind)
    for end in range(len(content)):
        with pytest.raises(RecordError, match=r"is (empty|none of|cut off)"):
            decode_picture(content[:end])
    assert decode_picture(content).shape[:2] == GREY.shape
    for share in (0.3, 0.5, 0.99):
        _refused(written, "cut off", content[: int(share * len(content))])
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")


def test_a_file_filled_up_with_zeros_is_refused(written):
    """As left by a disk that was full, or by a copy that was broken off."""
    for kind in (".png", ".jpg"):
        content = _encoded(GREY, kind)
        half = content[: len(content) // 2]
        _refused(written, "cut off|damaged", half + bytes(len(content) - len(half)))


def test_a_tiff_written_in_strips_or_by_others_is_checked(written):
    """Both byte orders, counts inside and outside the entry, by hand."""
    for order, magic in (("<", b"II*\0"), (">", b"MM\0*")):
        for strips in (1, 3):
            content = _tiff(order, magic, strips)
            np.testing.assert_array_equal(
                written(content, suffix=".tif").grey[0], GREY.astype(np.float32)
            )
            _refused(written, r"cut off .*Read error .* it has \d+ bytes", content[:-1])


def _tiff(order, magic, strips):
    rows = 12 // strips
    data = GREY.tobytes()
    tags = [(256, 3, [20]), (257, 3, [12]), (258, 3, [8]), (259, 3, [1]), (262, 3, [1])]
    first = 8 + 2 + 12 * 9 + 4
    after = first + (8 * strips if strips > 1 else 0)
    offsets = [after + 20 * rows * i for i in range(strips)]
    tags += [(273, 4, offsets), (277, 3, [1]), (278, 3, [rows]), (279, 4, [20 * rows] * strips)]
    body, outside = struct.pack(order + "H", 9), b""
    for tag, kind, values in tags:
        packed = struct.pack(f"{order}{len(values)}{'H' if kind == 3 else 'I'}", *values)
        if len(packed) > 4:
            packed, outside = struct.pack(order + "I", first + len(outside)), outside + packed
        body += struct.pack(order + "HHI", tag, kind, len(values)) + packed.ljust(4, b"\0")
    return magic + struct.pack(order + "I", 8) + body + bytes(4) + outside + data


def test_the_old_header_of_a_bmp_is_known(written):
    colour = np.dstack([GREY, GREY[::-1], GREY[:, ::-1]])
    head = struct.pack("<IHHHH", 12, 20, 12, 1, 24)
    content = b"BM" + struct.pack("<IHHI", 26 + 720, 0, 0, 26) + head + colour[::-1].tobytes()
    # OpenCV makes the colours of this header grey by itself, in whole levels.
    luminance = colour @ [0.114, 0.587, 0.299]
    np.testing.assert_allclose(decode_picture(content), luminance, atol=0.51)
    _refused(written, "cut off", content[:-1])


def test_damage_within_a_file_is_found_and_nothing_is_printed(written, capfd):
    for kind, message in (
        (".png", "libpng error"),
        (".jpg", "Corrupt JPEG data"),
        (".tif", "TIFF"),
    ):
        content = bytearray(_encoded(np.kron(GREY, np.ones((1, 1), np.uint8)), kind))
        for i in range(len(content) // 2, len(content) // 2 + 20):
            content[i] = content[i] ^ 0x5A if content[i] not in (0xFF, 0xA5) else content[i]
        _refused(written, f"damaged.*{message}", bytes(content))
    broken = _encoded(GREY, ".jpg")
    _refused(written, "damaged", broken[:2] + b"\0" + broken[3:])
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")


def test_a_png_with_too_few_pixels_inside_sound_chunks_is_refused(written, capfd):
    content = _png(zlib.compress(bytes(21 * 6)))
    _refused(written, "damaged, or of a kind that cannot be decoded", content)
    assert capfd.readouterr().err == ""


def _png(data, *extra):
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", 20, 12, 8, 0, 0, 0, 0)), *extra]
    chunks += [(b"IDAT", data), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )


def test_a_warning_that_spares_the_pixels_is_passed_over(written, capfd):
    rows = b"".join(b"\0" + row.tobytes() for row in GREY)
    odd = (b"iCCP", b"x\0\0" + zlib.compress(b"no profile"))
    seen = written(_png(zlib.compress(rows), odd))
    np.testing.assert_array_equal(seen.grey[0], GREY)
    assert capfd.readouterr().err == ""


def test_what_others_write_meanwhile_is_passed_on(capfd, monkeypatch):
    def decode(_content, _flags):
        os.write(2, b"a bar: 30 %\nlibpng warning: odd\nCorrupt JPEG data: so it says\nend")
        raise cv2.error("no")

    monkeypatch.setattr(cv2, "imdecode", decode)
    with pytest.raises(RecordError, match=r"\(Corrupt JPEG data: so it says\)"):
        decode_picture(_encoded(GREY))
    assert capfd.readouterr().err == "a bar: 30 %\nend"


def test_decoding_works_without_an_error_stream(monkeypatch):
    def closed(_stream):
        raise OSError(9, "Bad file descriptor")

    monkeypatch.setattr(os, "dup", closed)
    np.testing.assert_array_equal(decode_picture(_encoded(GREY)), GREY)


def test_a_missing_file_is_told_what_is_there(tmp_path):
    rig = _rig()
    for name in ("s3_c0.png", "s3_left.png", "s3_top.png"):
        (tmp_path / name).write_bytes(_encoded(GREY))

    def read(pattern):
        pictures.read_pictures(rig, pattern, folder=tmp_path, what="probing 'n07'")

    expected = (
        r"probing 'n07', camera 'c1': .*/s3_c1\.png: no such file; the pattern 's3_{camera}\.png'"
        r" fits the cameras 'c0', 'left', 'top': check the pattern and the names"
    )
    with pytest.raises(RecordError, match=expected):
        read("s3_{camera}.png")
    with pytest.raises(RecordError, match=r"s3_c0\.tif: no such file; near it are 's3_c0\.png'"):
        read("s3_{camera}.tif")
    with pytest.raises(RecordError, match=r"no such file; the folder has 's3_c0\.png', 's3_left"):
        read("frame.{camera}.0001")
    with pytest.raises(RecordError, match=r"for there is no folder .*images"):
        read("images/s3_{camera}.png")
    (tmp_path / "none").mkdir()
    with pytest.raises(RecordError, match="no such file; the folder is empty"):
        read("none/s3_{camera}.png")
    for i in range(20):
        (tmp_path / f"t_{i:02d}").write_bytes(b"")
    with pytest.raises(RecordError, match=r"fits the cameras '00', .*'07' and 12 more: check"):
        read("t_{camera}")


def test_a_pattern_for_one_camera_alone_is_refused(tmp_path):
    with pytest.raises(RecordError, match=r"step 's1': .*'s1\.png' has no {camera}, so all 2 cam"):
        pictures.read_pictures(_rig(), "s1.png", folder=tmp_path, what="step 's1'")


@pytest.mark.parametrize(
    ("level", "kind", "message"),
    [
        (0, np.uint8, r"is black all over \(grey levels 0 to 0\)"),
        (77, np.uint8, r"is of one grey all over \(grey levels 77 to 77\)"),
        (30000, np.uint16, "is of one grey all over"),
        (0.25, np.float32, "is of one grey all over"),
    ],
)
def test_a_picture_of_nothing_is_refused(written, level, kind, message):
    suffix = ".tif" if kind == np.float32 else ".png"
    flat = np.full((12, 20), level, dtype=kind)
    with pytest.raises(RecordError, match=rf"camera 'c1': .*{message}"):
        written(_encoded(GREY, suffix), second=_encoded(flat, suffix), suffix=suffix)


def test_a_constant_that_flickers_by_rounding_is_nothing_either(written):
    noise = GREY % 3
    _refused(written, r"is black all over \(grey levels 0 to 2\)", _encoded(noise))
    assert written(_encoded(GREY % 4)).grey[0].max() == 3.0
    # Alpha is no content.
    _refused(written, "is of one grey", _encoded(np.dstack([GREY // 255 + 9] * 3 + [GREY])))


def test_grey_levels_that_are_not_finite_are_refused(written):
    levels = GREY.astype(np.float32)
    levels[3, 4] = np.nan
    levels[5, 6:9] = np.inf
    _refused(written, "has 4 grey levels that are not finite", _encoded(levels, ".tif"))
    _refused(written, "has 240 grey levels", _encoded(GREY.astype(np.float64) * 1e300, ".tif"))


def test_other_types_of_grey_levels_are_refused(written, monkeypatch):
    _refused(written, "grey levels of type int32", _encoded(GREY.astype(np.int32), ".tif"))
    monkeypatch.setattr(pictures, "decode_picture", lambda _content: np.dstack([GREY] * 2))
    with pytest.raises(RecordError, match=r"camera 'c0': .* has 2 channels; must be grey, RGB or"):
        written(_encoded(GREY))


def _ramp_file(kind: str, pixels: np.ndarray = RAMP) -> bytes:
    return cv2.imencode(kind, pixels)[1].tobytes()


def _old_bmp() -> bytes:
    return b"BM" + struct.pack("<IHHI", 26, 0, 0, 26) + struct.pack("<IHHHH", 12, 20, 12, 1, 8)


def _large_tiff() -> bytes:
    """BigTIFF in the other byte order: a directory of two entries."""
    entries = struct.pack(">HHQQ", 256, 16, 1, 20) + struct.pack(">HHQI4x", 257, 4, 1, 12)
    return b"MM\0+" + struct.pack(">HHQQ", 8, 0, 16, 2) + entries


@pytest.mark.parametrize("kind", [".png", ".jpg", ".tif", ".bmp"])
def test_the_size_is_that_of_the_pixels(kind):
    assert claimed_size(_ramp_file(kind)) == (20, 12)
    assert claimed_size(_ramp_file(kind, np.dstack([RAMP] * 3))) == (20, 12)


def test_rare_headers_are_known():
    assert claimed_size(_old_bmp()) == (20, 12)
    assert claimed_size(_large_tiff()) == (20, 12)


@pytest.mark.parametrize("kind", [".png", ".jpg", ".tif", ".bmp"])
def test_a_header_cut_off_anywhere_has_none_or_the_right_one(kind):
    content = _ramp_file(kind)
    assert {claimed_size(content[:end]) for end in range(len(content))} <= {None, (20, 12)}


def test_a_size_that_no_camera_has_is_refused_before_memory_is_taken(tmp_path):
    content = bytearray(_ramp_file(".png"))
    content[16:24] = struct.pack(">II", 30_000, 30_000)
    (tmp_path / "s_c0.png").write_bytes(content)
    beside = np.eye(4)
    beside[0, 3] = -0.1
    first, second = (
        Camera(name, None, np.diag([50.0, 50.0, 1.0]), np.zeros(8), pose)
        for name, pose in (("c0", np.eye(4)), ("c1", beside))
    )
    rig = Rig((first, second), 0, "rig.toml")
    tracemalloc.start()
    with pytest.raises(RecordError, match=r"camera 'c0': .*s_c0\.png: has 30000 x 30000 pixels"):
        read_pictures(rig, "s_{camera}.png", folder=tmp_path, what="step 's'")
    # Of the 900 MB that it claims.
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()


@pytest.mark.parametrize("length", [100, 0xF4002F49, 0x7FFFFFFF])
def test_a_chunk_longer_than_its_file_takes_no_memory(length):
    content = _ramp_file(".png")
    index = content.index(b"IDAT") - 4
    damaged = content[:index] + struct.pack(">I", length + len(content)) + content[index + 4 :]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RecordError, match=r"is cut off or damaged.*it has \d+ bytes"):
        decode_picture(damaged)
    # Kilobytes: OpenCV would take four gigabytes for the longest.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


def test_what_follows_the_end_of_a_png_does_not_matter():
    np.testing.assert_array_equal(decode_picture(_ramp_file(".png") + b"more"), RAMP)


def _film(path: Path, levels: list[int]) -> Path:
    """A lossless film of 25 frames a second, each frame of one grey level."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 25.0, _SIZE)
    for level in levels:
        writer.write(np.full((*_SIZE[::-1], 3), level, np.uint8))
    writer.release()
    return path


def test_every_frame_comes_once_in_order_with_its_time(tmp_path: Path) -> None:
    frames = list(video_frames(_film(tmp_path / "c0.avi", [10, 60, 110, 160])))
    assert [int(np.median(grey)) for _, grey in frames] == [10, 60, 110, 160]
    assert {grey.shape for _, grey in frames} == {_SIZE[::-1]}
    # To a microsecond: times are counted in milliseconds.
    np.testing.assert_allclose([time for time, _ in frames], np.arange(4) / 25.0, atol=1e-6)


def test_a_single_frame_is_refused_for_what_it_is_before_it_is_used(tmp_path: Path) -> None:
    frames = video_frames(_film(tmp_path / "c0.avi", [100]))
    with pytest.raises(RecordError, match=r"c0\.avi: only one frame can be decoded") as caught:
        next(frames)
    assert "convert it" in str(caught.value)
