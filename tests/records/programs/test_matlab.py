"""MATLAB's stereoParameters: structures of all versions, and objects that cannot be read."""

import struct
import sys

import h5py
import numpy as np
import pytest
from program_files import cv_pixels
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from palpate import files
from palpate.errors import CalibrationError, InputError, RecordError
from palpate.records import read_rig
from palpate.records.programs.matlab import read_mat
from palpate.vision import project

TURN = Rotation.from_rotvec([0.05, -0.3, 0.02]).as_matrix()
SHIFT = np.array([-120.0, 3.0, 15.0])
INNER = [
    np.array([[2100.0, 0.7, 640.5], [0.0, 2090.0, 500.25], [0.0, 0.0, 1.0]]),
    np.array([[2050.0, 0.0, 655.0], [0.0, 2055.0, 480.0], [0.0, 0.0, 1.0]]),
]
LENS = [([-0.1, 0.2], [1e-3, -5e-4]), ([-0.12, 0.21, 0.05], [0.0, 2e-4])]
CONTENT = {
    "cell": np.array([np.eye(2), np.arange(3.0), "text"], dtype=object),
    "struct": {"a": 1 + 2j, "b": {"c": np.float32(3.0), "d": np.zeros((0, 3))}},
    "flags": np.array([True, False]),
    "whole": np.array([[1, 2, 3]], dtype=np.int16),
}


def _struct(*, newer=False, units="millimeters"):
    """What toStruct gives: row vectors times matrices, pixels from 1."""
    cameras = {}
    for i, (inner, (radial, tangential)) in enumerate(zip(INNER, LENS, strict=True), start=1):
        matrix = inner.copy()
        matrix[:2, 2] += 1.0
        cameras[f"CameraParameters{i}"] = {
            ("K" if newer else "IntrinsicMatrix"): matrix if newer else matrix.T,
            "RadialDistortion": np.array(radial),
            "TangentialDistortion": np.array(tangential),
            "ImageSize": np.array([1024.0, 1280.0]),
            "WorldUnits": units,
            "RotationVectors": np.zeros((5, 3)),
        }
    return {**cameras, "RotationOfCamera2": TURN.T, "TranslationOfCamera2": SHIFT}


def _write_hdf5(path, content):
    """As -v7.3 writes structures: groups, arrays transposed, text as its code points."""

    def put(group, values):
        for name, value in values.items():
            if isinstance(value, dict):
                put(group.create_group(name), value)
            elif isinstance(value, str):
                group[name] = np.array([[ord(letter)] for letter in value], dtype=np.uint16)
                group[name].attrs["MATLAB_class"] = b"char"
            else:
                group[name] = np.atleast_2d(value).T
                group[name].attrs["MATLAB_class"] = b"double"

    with h5py.File(path, "w", userblock_size=512) as file:
        put(file, content)
    return path


def _object_file(path):
    """A variable p of the class stereoParameters, as version 5 stores objects."""

    def element(kind, data):
        return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    reference = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1))
    reference += element(1, b"") + element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    body = element(6, struct.pack("<II", 17, 0)) + element(1, b"p") + element(1, b"MCOS")
    body += element(1, b"stereoParameters") + element(14, reference)
    head = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + struct.pack("<HH", 0x0100, 0x4D49)
    path.write_bytes(head + element(14, body))
    return path


def _check(rig):
    points = np.random.default_rng(5).uniform(-0.05, 0.05, (20, 3)) + np.array([0.05, 0, 0.6])
    poses = [(np.eye(3), np.zeros(3)), (TURN, SHIFT)]
    assert [camera.name for camera in rig.cameras] == ["1", "2"]
    for camera, (turn, shift), inner, lens in zip(rig.cameras, poses, INNER, LENS, strict=True):
        assert camera.size == (1280, 1024)
        radial, tangential = lens
        terms = [*radial[:2], *tangential, *radial[2:]]
        wanted = cv_pixels(1e3 * points @ turn.T + shift, inner, terms)
        # Millimetres and metres round differently.
        np.testing.assert_allclose(project(camera, points), wanted, atol=1e-9)


@pytest.mark.parametrize("newer", [False, True])
@pytest.mark.parametrize("within", [(), ("s",), ("DIC3D", "stereoParams")])
@pytest.mark.parametrize("version", ["5", "7.3"])
def test_structures(tmp_path, newer, within, version):
    content = _struct(newer=newer)
    for name in reversed(within):
        content = {name: content, "other": np.eye(2)}
    path = tmp_path / "stereo.mat"
    if version == "5":
        savemat(path, content)
    else:
        _write_hdf5(path, content)
    _check(read_rig(path))


def test_files_of_version_7_3_need_their_package_and_older_ones_do_not(tmp_path, monkeypatch):
    savemat(tmp_path / "old.mat", _struct())
    _write_hdf5(tmp_path / "new.mat", _struct())
    monkeypatch.setitem(sys.modules, "h5py", None)
    _check(read_rig(tmp_path / "old.mat"))
    with pytest.raises(InputError, match=r"reading new\.mat needs .*'palpate\[hdf5\]'"):
        read_rig(tmp_path / "new.mat")


def test_units(tmp_path):
    path = tmp_path / "stereo.mat"
    for said, given, length in (("cm", None, 1e-2), ("inches", None, 0.0254), ("", "m", 1.0)):
        savemat(path, _struct(units=said))
        shift = read_rig(path, length_unit=given).cameras[1].T_camera_object[:3, 3]
        np.testing.assert_allclose(shift, length * SHIFT, rtol=1e-12)


def test_objects_are_refused_with_the_cure(tmp_path):
    message = r"holds an object \(stereoParameters\), which only MATLAB can read; .* toStruct\(p\)"
    with pytest.raises(CalibrationError, match=message):
        read_rig(_object_file(tmp_path / "calibrationSession.mat"))
    path = tmp_path / "stereo.mat"
    with h5py.File(path, "w") as file:
        file["p"] = np.zeros((6, 1), dtype=np.uint32)
        file["p"].attrs["MATLAB_class"] = b"stereoParameters"
        file["p"].attrs["MATLAB_object_decode"] = 3
    with pytest.raises(CalibrationError, match=message):
        read_rig(path)


def _read(path):
    return read_mat(path, what="is odd", cure="save it again")


@pytest.mark.parametrize("compressed", [False, True])
def test_what_was_saved_comes_back(tmp_path, compressed):
    savemat(tmp_path / "a.mat", CONTENT, do_compression=compressed)
    value = _read(tmp_path / "a.mat")
    np.testing.assert_array_equal(value["cell"][0], np.eye(2))
    assert value["cell"][2] == "text"
    assert value["struct"]["a"] == 1 + 2j
    assert value["struct"]["b"]["c"] == 3.0
    np.testing.assert_array_equal(value["whole"], [1, 2, 3])


def test_a_wrong_bit_anywhere_in_the_structure_is_survived(tmp_path):
    """Each of these bits ended the process in SciPy 1.16, or is one beside such a bit."""
    path = tmp_path / "a.mat"
    savemat(path, CONTENT)
    whole = path.read_bytes()
    refused = 0
    for index in range(128, len(whole), 3):
        for bit in (0, 3, 7):
            content = bytearray(whole)
            content[index] ^= 1 << bit
            path.write_bytes(content)
            try:
                _read(path)
            except RecordError as error:
                refused += "is odd" in str(error)
    # Types, sizes and counts are refused; names, padding and numbers pass.
    assert refused > 200


def test_a_size_that_is_only_claimed_takes_no_memory(tmp_path):
    path = tmp_path / "a.mat"
    savemat(path, {"cell": np.array([1.0, 2.0], dtype=object)})
    content = bytearray(path.read_bytes())
    index = content.index((2).to_bytes(4, "little"), 150)
    content[index : index + 4] = (2**31 - 1).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(RecordError, match=r"is odd .*do not belong together.*save it again"):
        _read(path)


def test_a_few_bytes_that_unpack_to_many_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_ANY_RATIO_BYTES", 2**16)
    path = tmp_path / "a.mat"
    savemat(path, {"a": np.zeros(2**18)}, do_compression=True)
    with pytest.raises(RecordError, match="cut off, or too large"):
        _read(path)
    # Nor may many elements together, none of which is too large.
    savemat(path, {f"a{k}": np.zeros(2**12) for k in range(40)}, do_compression=True)
    with pytest.raises(RecordError, match="cut off, or too large"):
        _read(path)
