"""Kinds of results that are not Palpate's, were changed, or contradict themselves."""

import fcntl
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from faults.kind import Kind, replaced, written

from palpate.records import CONSTANT_NAMES
from palpate.records.files.results import CONTENTS_FILE, file_sums, sums_text

FIT = ("fit", "cube", "--out", "result")
POKE = ("poke", "cube", "--force", "0", "0", "-1", "--at", "0.02", "0.02", "0.04", "--result")
SCREEN = ("report", "result", "--out", "again.html")
PAPER = ("report", "result", "--for", "paper")
SIZES = ("--diameter", "50mm", "--height", "30mm")
COMPRESSION = ("compression", "record.csv", *SIZES, "--out")
_HELD = []

_TERM = {"time": {"value": 3.0, "std": 0.1, "ci95": [2.8, 3.2]}, "share": 0.6}
_RELAXATION = {
    "constant": "shear_modulus", "age": 12.0, "rise": 0.5, "hold": 100.0, "unrelaxed": 2e4,
    "terms": [_TERM], "curve": [], "instantaneous": None, "long_term": None, "remarks": [],
}  # fmt: skip


def _value(*keys: str | int, to: Any) -> Callable[[Path], object]:
    """Damage: another value in the estimate, whatever its sum says."""

    def damage(folder: Path) -> None:
        path = folder / "result" / "estimate.json"
        content = table = json.loads(path.read_text())
        for key in keys[:-1]:
            table = table[key]
        table[keys[-1]] = to
        path.write_text(json.dumps(content))

    return damage


def _sealed(damage: Callable[[Path], object]) -> Callable[[Path], object]:
    """Damage: the same, by somebody who corrects the checksums too."""

    def sealed(folder: Path) -> None:
        damage(folder)
        result = folder / "result"
        contents = result / CONTENTS_FILE
        files = [file for file in result.rglob("*") if file.is_file() and file != contents]
        head = contents.read_text().splitlines()[0]
        contents.write_text(f"{head}\n{sums_text(file_sums(files, start=result))}")

    return sealed


def _array(name: str, to: Any) -> Callable[[Path], object]:
    """Damage: another array in the fitted surface, the rest being as it was."""

    def damage(folder: Path) -> None:
        path = folder / "result" / "surface.npz"
        with np.load(path) as stored:
            content = dict(stored)
        np.savez(path, **content | {name: np.array(to)})

    return _sealed(damage)


def _both(*damages: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda folder: [damage(folder) for damage in damages]


def _probing_twice(folder: Path) -> None:
    path = folder / "result" / "estimate.json"
    content = json.loads(path.read_text())
    content["probes"] = 2 * content["probes"][:1]
    path.write_text(json.dumps(content))


def _made(name: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).mkdir()


def _gone(name: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).unlink()


def _linked(name: str, target: str) -> Callable[[Path], object]:
    def damage(folder: Path) -> None:
        (folder / name).symlink_to(target)

    return damage


def _result_in(name: str) -> Callable[[Path], object]:
    """Damage: the result stands under another name, with something of the user's in it."""

    def damage(folder: Path) -> None:
        shutil.copytree(folder / "result", folder / name)
        (folder / name / "notes.txt").write_text("mine")

    return damage


def _locked(name: str) -> Callable[[Path], object]:
    """Damage: another process is writing there."""

    def damage(folder: Path) -> None:
        lock = folder / f".{name}.lock"
        lock.write_text("process 4711 on another")
        _HELD.append(lock.open())
        fcntl.flock(_HELD[-1], fcntl.LOCK_EX)

    return damage


def _nothing(_: Path) -> None:
    pass


def _estimate(name: str, damage: Callable[[Path], object], *says: str) -> Kind:
    return Kind(f"an estimate with {name}", damage, (*POKE, "result"), says, example="results")


def _pictured(content: bytes) -> Callable[[Path], object]:
    """Damage: a picture of a probing that is no picture."""

    def damage(folder: Path) -> None:
        (folder / "result" / "displacement").mkdir(exist_ok=True)
        (folder / "result" / "displacement" / "n01.png").write_bytes(content)

    return _sealed(damage)


# The first 33 bytes of a picture that would take 10 GB.
_VAST = bytes.fromhex("89504e470d0a1a0a0000000d494844520000ea600000ea6008020000000fb0e215")


def _reported(name: str, damage: Callable[[Path], object], *says: str) -> Kind:
    return Kind(f"a result with {name}", damage, PAPER, says, example="results")


def _refused(name: str, damage: Callable[[Path], object], command: tuple, *says: str) -> Kind:
    return Kind(name, damage, command, says, example="results")


_FIT_KINDS = [
    _refused("a result that was edited", replaced("result/estimate.json", "ok", "OK"), FIT,
             "result: is a result that was changed since: estimate.json (changed)", "--force"),
    _refused("a result with one file more", written("result/notes.txt", "mine"), FIT,
             "notes.txt (not listed)", "--out"),
    _refused("a result with one file less", _gone("result/table.csv"), FIT,
             "table.csv (missing)"),
    _refused("a result with a link in it", _linked("result/link", ".."), FIT,
             "link (not listed)"),
    _refused("a result of an earlier version",
             written("result/contents.txt", "palpate result folder; files:\nestimate.json\n"), FIT,
             "earlier version", "--force"),
    _refused("a result whose contents are binary", written("result/contents.txt", b"\xff\xfe"), FIT,
             "no result of Palpate's"),
    _refused("a result without contents", _gone("result/contents.txt"), FIT,
             "no result of Palpate's", "estimate.json"),
    _refused("a folder of the user's as --out", written("cube/diary.txt", "mine"),
             ("fit", "cube", "--out", "cube"), "cube: holds files that are no result of Palpate's"),
    _refused("a file as --out of fit", _nothing, ("fit", "cube", "--out", "record.csv"),
             "record.csv: is not a folder"),
    _refused("a link to a folder as --out", _linked("link", "result"), (*FIT[:-1], "link"),
             "link: is not a folder"),
    _refused("a dangling link as --out", _linked("link", "nowhere"), (*FIT[:-1], "link"),
             "link: is not a folder"),
    _refused("the current folder as --out", _nothing, (*FIT[:-1], "."), "more than that"),
    _refused("the folder above as --out", _nothing, (*FIT[:-1], ".."), "more than that"),
    _refused("the root as --out", _nothing, (*FIT[:-1], "/"), "more than that"),
    _refused("--out below a file", _nothing, (*FIT[:-1], "record.csv/below"), "is not a folder"),
    _refused("--out below no folder", _nothing, (*FIT[:-1], "none/below"), "is not a folder"),
    _refused("a result that another process is writing", _locked("result"), FIT,
             "result: is being written by process 4711 on another", "wait"),
    _refused("a result of fit as --out of flow", _nothing, ("flow", "cube", "--out", "result"),
             "is a result of `palpate fit`"),
    _refused("a result of fit as --out of lab", _nothing, ("lab", "demo", "result"),
             "is a result of `palpate fit`"),
    _refused("the default result holds something of the user's", _result_in("cube-result"),
             ("fit", "cube"), "notes.txt (not listed)"),
]  # fmt: skip

_COMPRESSION_KINDS = [
    _refused("--out of compression is the record", _nothing, (*COMPRESSION, "record.csv"),
             "record.csv: --out names one of the records"),
    _refused("--out of compression is the record, by another name",
             _linked("same.csv", "record.csv"), (*COMPRESSION, "same.csv"),
             "--out names one of the records"),
    _refused("--out of compression is the record, by force", _nothing,
             (*COMPRESSION, "record.csv", "--force"), "--out names one of the records"),
    _refused("--out of compression is another record", written("other.csv", "1,2\n"),
             (*COMPRESSION, "other.csv"), "other.csv: is there already; nothing was touched",
             "--force"),
    _refused("--out of compression is a dangling link", _linked("other.json", "nowhere"),
             (*COMPRESSION, "other.json"), "other.json: is there already"),
    _refused("--out of compression is a folder", _made("other"), (*COMPRESSION, "other"),
             "other: is there already; nothing was touched: choose another name"),
    _refused("--out of compression is in no folder", _nothing, (*COMPRESSION, "none/a.json"),
             "cannot be written"),
    _refused("--out of compression is being written", _locked("other.json"),
             (*COMPRESSION, "other.json"), "is being written by process 4711"),
]  # fmt: skip

_ESTIMATE_KINDS = [
    _estimate("a key twice",
              replaced("result/estimate.json", '"method":', '"method": "other",\n "method":'),
              "estimate.json: has 'method' twice in one object; keep one"),
    _estimate("a probing twice", _probing_twice, "2 probings have 1 names; each its own"),
    _estimate("a constant that is not told and status ok",
                   _value("identifiable", "poisson_ratio", to=False), "status is 'ok'"),
    _estimate("a status of its own", _value("status", to="fine"), "status: is 'fine'"),
    _estimate("a status that is no text", _value("status", to=3), "status: is 3"),
    _estimate("a negative std", _value("young_modulus", "std", to=-1.0), "std is -1"),
    _estimate("nu = 3", _value("poisson_ratio", to={"value": 3, "std": 0, "ci95": [3, 3]}),
                   "poisson_ratio is 3"),
    _estimate("nu = -1", _value("poisson_ratio", to={"value": -1, "std": 0, "ci95": [-1, 0]}),
                   "poisson_ratio is -1"),
    _estimate("G < 0", _value("shear_modulus", to={"value": -1, "std": 0, "ci95": [-1, 0]}),
                   "shear_modulus is -1 Pa; must be positive"),
    _estimate("another E than 2 G (1 + nu)",
                   _value("young_modulus", to={"value": 71234.5, "std": 1, "ci95": [0, 1e5]}),
                   "young_modulus is 71234.5 Pa, but 2 G (1 + nu) is"),
    _estimate("a value outside its interval", _value("shear_modulus", "ci95", to=[1, 2]),
                   "lies outside its ci95, 1 to 2"),
    _estimate("an interval the wrong way round", _value("shear_modulus", "ci95", to=[2, 1]),
                   "lower end"),
    _estimate("an std wider than its interval", _value("young_modulus", "std", to=2400.0),
                   "young_modulus has std 2400, but ci95 57600 to 62400"),
    _estimate("an std of nothing in an interval", _value("poisson_ratio", "std", to=0.0),
                   "poisson_ratio has std 0, but ci95 0.288 to 0.312"),
    _estimate("no std of what is identifiable", _value("shear_modulus", "std", to=None),
                   "shear_modulus is identifiable", "no std"),
    _estimate("an open interval of what is identifiable", _value("young_modulus", "ci95", to=[None, None]),
                   "young_modulus is identifiable", "no std"),
    _estimate("an E that is known better than G and nu",
                   _value("young_modulus", to={"value": 60000, "std": 20, "ci95": [59960, 60040]}),
                   "shear_modulus has std", "as E is 2 G (1 + nu)"),
    _estimate("an E that is known worse than G and nu",
                   _value("young_modulus", to={"value": 6e4, "std": 1e4, "ci95": [4e4, 8e4]}),
                   "young_modulus has std 10000", "as E is 2 G (1 + nu)"),
    _estimate("a relaxation of Poisson's ratio",
                   _value("relaxation", to=_RELAXATION | {"constant": "poisson_ratio"}),
                   "[relaxation]: constant is 'poisson_ratio'"),
    _estimate("a Prony series that leaves nothing",
                   _value("relaxation", to=_RELAXATION | {"terms": 2 * _RELAXATION["terms"]}),
                   "[relaxation]", "sum to 1 or more"),
    _estimate("a relaxation at no time",
                   _value("relaxation", to=_RELAXATION | {"hold": None}), "[relaxation]", "a time"),
    _estimate("more rejected points than can be counted",
                   _value("probes", 0, "rejected", to=10**400), "number 1 rejected"),
    _estimate("a negative residual", _value("probes", 0, "rms_residual", to=-1e-4),
                   "number 1: rms_residual is -0.0001"),
    _estimate("a negative prediction error", _value("probes", 0, "prediction_error", to=-1),
                   "prediction_error is -1"),
    _estimate("a probing that tells one constant of three",
                   _value("probes", 0, "identifiable", to={"shear_modulus": True}),
                   "identifiable has the keys"),
    _estimate("a probing of another E than 2 G (1 + nu)", _both(
                   _value("probes", 0, "identifiable", to=dict.fromkeys(CONSTANT_NAMES, True)),
                   _value("probes", 0, "young_modulus",
                          to={"value": 71234.5, "std": 1, "ci95": [0, 1e5]})),
                   "number 1: young_modulus is 71234.5 Pa, but 2 G (1 + nu) is"),
    _estimate("a probing with an std wider than its interval", _both(
                   _value("probes", 0, "identifiable", to=dict.fromkeys(CONSTANT_NAMES, True)),
                   _value("probes", 0, "young_modulus", "std", to=2400.0)),
                   "probing 'n01': young_modulus has std 2400"),
    _estimate("negative seconds", _value("seconds", to={"total": -1}), "total: is -1"),
    _estimate("an interval of one end", _value("shear_modulus", "ci95", to=[1]), "ci95: is [1]"),
    _estimate("an interval that is a number", _value("shear_modulus", "ci95", to=1), "ci95: is 1"),
    _estimate('"yes" for true', _value("identifiable", "poisson_ratio", to="yes"),
                   "poisson_ratio: is 'yes'", "true or false"),
    _estimate("1 for true", _value("identifiable", "poisson_ratio", to=1), "is 1", "true or false"),
    _estimate("true for a number", _value("shear_modulus", "value", to=True), "value: is True"),
    _estimate("NaN", _value("shear_modulus", "value", to=float("nan")), "value: is nan"),
    _estimate("infinity", _value("shear_modulus", "std", to=float("inf")), "std: is inf"),
    _estimate("no value of what is identifiable", _value("shear_modulus", "value", to=None),
                   "shear_modulus is identifiable", "no value"),
    _estimate("a text for a number", _value("shear_modulus", "value", to="21 kPa"), "is '21 kPa'"),
    _estimate("a number for a constant", _value("shear_modulus", to=3), "must be a table"),
    _estimate("a number for all probings", _value("probes", to=3), "probes: is 3"),
    _estimate("numbers for probings", _value("probes", to=[3]), "probes: is [3]"),
    _estimate("a nameless probing", _value("probes", 0, "name", to=""), "number 1: name is"),
    _estimate("half a point", _value("probes", 0, "observed", to=0.5), "observed: is 0.5"),
    _estimate("fewer than no points", _value("probes", 0, "rejected", to=-1), "rejected: is -1"),
    _estimate("no key of a probing", _value("probes", 0, to={}), "is missing"),
    _estimate("seconds in words", _value("seconds", to={"total": "long"}), "total: is 'long'"),
    _estimate("seconds that are a list", _value("seconds", to=[]), "seconds: is []"),
    _estimate("settings that are a text", _value("settings", to="usual"), "settings: is 'usual'"),
    _estimate("a note that is no text", _value("notes", to=[3]), "notes: is [3]"),
    _estimate("a method that is no text", _value("method", to=3), "method: is 3"),
    _estimate("another format", _value("format", to="palpate-estimate/9"), "palpate-estimate/9"),
    _estimate("no format", _value("format", to=None), "format: is None"),
    _estimate("an empty file", written("result/estimate.json", ""), "not valid JSON"),
    _estimate("half a file", written("result/estimate.json", '{"format": "pal'), "not valid JSON"),
    _estimate("a list", written("result/estimate.json", "[1]"), "must be an object"),
    _estimate("nesting without end", written("result/estimate.json", "[" * 100_000),
                   "not valid JSON"),
    _estimate("bytes that are no text", written("result/estimate.json", b"\xff\xfe"), "UTF-8"),
]  # fmt: skip

# What `palpate report` reads besides.
_REPORT_KINDS = [
    _reported("settings of an earlier version", _sealed(_value("settings", to={})),
              "estimate.json: [settings]: do not say the errors", "fit again"),
    _reported("errors without a pose",
              _sealed(_value("settings", to={"errors": {"force_gain": 0.1}, "noise": "normal"})),
              "[settings] errors: the key 'pose_rotation' is missing"),
    _reported("an assumed error in words",
              _sealed(_value("settings", to={"errors": {"pose_rotation": "1 deg"}, "noise": "t"})),
              "[settings] errors pose_rotation: is '1 deg'; must be a finite number"),
    _reported("a list of versions", _sealed(_value("settings", to={"versions": ["0.1"]})),
              "[settings] versions: is ['0.1']; must be a table"),
    _reported("half a character", _sealed(_value("method", to="\ud800")),
              "estimate.json: is not valid JSON", "surrogates not allowed"),
    Kind("a result with half a picture", _pictured(_VAST[:20]), SCREEN,
         ("displacement/n01.png: is no whole picture", "fit the session again"), "results"),
    Kind("a result with a vast picture", _pictured(_VAST), SCREEN,
         ("displacement/n01.png: is no whole picture", "fit the session again"), "results"),
    _reported("no probing in its surface", _array("probings", np.zeros(0, dtype=str)),
              "surface.npz: there is no probing", "fit the session again"),
    _reported("a contact nowhere", _array("1/contact", [0.0, np.nan, 0.0]),
              "surface.npz: contact has 1 entries that are not finite"),
    _reported("a force without end", _array("1/force", [0.0, 0.0, -np.inf]),
              "surface.npz: force has 1 entries that are not finite"),
    _reported("forces in words", _array("1/force", "strong"), "surface.npz: is damaged"),
    _reported("points in the plane", _array("1/points", np.zeros((3, 2))),
              "surface.npz: is damaged"),
    _reported("a surface of another mesh", _array("1/surface", np.zeros((3, 3))),
              "surface.npz: surfaces of probings are those of another mesh"),
    _reported("a likelihood of nothing",
              _array("likelihood/poisson_ratio", np.full(40, np.nan)),
              "surface.npz: poisson_ratio has 40 entries that are not finite"),
]  # fmt: skip

KINDS = [*_FIT_KINDS, *_COMPRESSION_KINDS, *_ESTIMATE_KINDS, *_REPORT_KINDS]
