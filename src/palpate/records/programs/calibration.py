"""Which calibration program wrote a file, and its reader.

Every program has its own conventions; they are told in the reader of each. In the `Rig` all are the
same: metres, x_camera = R x_object + t, the centre of the first pixel is (0, 0).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml

from palpate.errors import RecordError
from palpate.records.programs.calibration_dice import is_dice, read_dice
from palpate.records.programs.calibration_matchid import read_matchid
from palpate.records.programs.calibration_multidic import read_multidic
from palpate.records.programs.calibration_vic3d import read_vic3d
from palpate.records.programs.kalibr import read_kalibr
from palpate.records.programs.opencv import (
    counterpart,
    is_opencv,
    opencv_entries,
    read_opencv,
    read_opencv_cameras,
)
from palpate.records.rig import Rig

_KNOWN = (
    "known are rig.toml, OpenCV (YAML, JSON, XML), VIC-3D and DICe (XML), MatchID (.caldat), Kalibr"
    " (camchain YAML) and MultiDIC (DLTstruct_cam_*.mat)"
)
_TREES = (".yml", ".yaml", ".json", ".xml")


def read_calibration(path: Path, *, length_unit: str | None) -> Rig:
    """Rig of a calibration file of another program, told apart by its content.

    Parameters
    ----------
    path : Path                     a file; or a folder with a file per camera (MultiDIC, OpenCV)
    length_unit : str or None       m, cm, mm or in, for files that do not say theirs; None: what
                                    the program uses

    Returns
    -------
    Rig                             the first camera is the reference

    Raises
    ------
    RecordError                     not there, not readable, of no known kind
    CalibrationError                contents that are missing or contradictory
    """
    if path.is_dir():
        return _read_folder(path, length_unit)
    if path.suffix.lower() == ".mat":
        return read_multidic(path, length_unit=length_unit)
    root = _tree(path)
    if isinstance(root, ElementTree.Element):
        if is_dice(root):
            return read_dice(path, root, length_unit=length_unit)
        if root.find(".//camera/orientation") is not None:
            return read_vic3d(path, root, length_unit=length_unit)
    elif isinstance(root, str):
        if "cam0_fx" in root.lower():
            return read_matchid(path, root, length_unit=length_unit)
        raise RecordError(f"{path}: is no camera calibration; {_KNOWN}")
    elif isinstance(root.get("cam0"), dict):
        return read_kalibr(path, root, length_unit=length_unit)
    entries = opencv_entries(root)
    if not is_opencv(entries):
        found = ", ".join(list(entries)[:8])
        raise RecordError(f"{path}: is no camera calibration (it holds: {found}); {_KNOWN}")
    twin = counterpart(path)
    beside = None if twin is None else _entries(twin)
    return read_opencv(path, entries, beside=beside, length_unit=length_unit)


def _read_folder(path: Path, length_unit: str | None) -> Rig:
    """MultiDIC's transformations, or OpenCV files of one camera each."""
    if any(path.glob("DLTstruct_cam_*.mat")):
        return read_multidic(path, length_unit=length_unit)
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in _TREES)
    cameras = [(file, entries) for file in files if is_opencv(entries := _entries(file))]
    if not cameras:
        raise RecordError(f"{path}: the folder holds no calibration of a camera; {_KNOWN}")
    return read_opencv_cameras(path, cameras, length_unit=length_unit)


def _entries(path: Path) -> Mapping[str, Any]:
    root = _tree(path)
    return {} if isinstance(root, str) else opencv_entries(root)


def _tree(path: Path) -> ElementTree.Element | dict[str, Any] | str:
    """Content of a file: XML, YAML or JSON, or lines of text."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from error
    if data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        try:
            return ElementTree.fromstring(data.lstrip())
        except ElementTree.ParseError as error:
            raise RecordError(f"{path}: is not valid XML: {error}") from error
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordError(f"{path}: is not a text file in UTF-8; {_KNOWN}") from error
    if path.suffix.lower() not in _TREES or "cam0_fx" in text.lower():
        return text
    return _yaml(path, text)


class _Loader(yaml.SafeLoader):
    """Plain values, and OpenCV's matrices as tables."""


def _matrix(loader: _Loader, node: yaml.MappingNode) -> Any:
    return loader.construct_mapping(node, deep=True)


for _kind in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _matrix)


def _yaml(path: Path, text: str) -> dict[str, Any]:
    """Root table of a YAML or JSON file; OpenCV's first line (%YAML:1.0) is no valid YAML."""
    if text.startswith("%YAML"):
        text = text.partition("\n")[2]
    try:
        root = yaml.load(text, Loader=_Loader)  # a SafeLoader: plain values only
    except yaml.YAMLError as error:
        raise RecordError(f"{path}: is not valid YAML: {error}") from error
    if not isinstance(root, dict):
        raise RecordError(f"{path}: holds no names with values; {_KNOWN}")
    return root
