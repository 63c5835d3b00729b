"""Damage files so that ever more lines of their readers run, with atheris, which is not locked:

    .venv/bin/pip install atheris
    make fuzz-coverage SECONDS=1800

What is raised that is no error of ours, or takes too long, is written into `build/fuzz`, a file for
each place: mend it, and put the file into the folder of its sample in `tests/faults/corpus`.
"""

import hashlib
import io
import os
import sys
import tempfile
import time
import traceback
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import atheris

_INSTRUMENTED = (
    "palpate.records", "palpate.files", "palpate.geometry.mesh_content",
    "palpate.geometry.mesh_files", "palpate.scanning.scan_file", "palpate.probe.compression_files",
    "palpate.recording", "palpate.lab.config", "palpate.lab.config_files",
)  # fmt: skip
with atheris.instrument_imports(include=list(_INSTRUMENTED), enable_loader_override=False):
    from faults.samples import Reader, write_samples
    from faults.test_fuzz import read_damaged

# Files of bytes rather than numbers, and what takes a child each time: not ten thousand of those.
_LARGEST = 20_000
_IN_CHILDREN = (".avi", ".e57", ".e", ".mat", ".msh", ".vtk", ".vtu")


def _run(samples: list[tuple[Path, Reader]], folder: Path) -> None:
    goods = [path.read_bytes() for path, _ in samples]

    def try_one(data: bytes) -> None:
        """The first byte chooses the sample, the others take its place."""
        number = data[0] % len(samples) if data else 0
        path, read = samples[number]
        start = time.perf_counter()
        said = io.StringIO()
        try:
            with redirect_stdout(said), redirect_stderr(said):
                read_damaged(path, read, data[1:])
        except Exception as error:  # noqa: BLE001 - they are what is sought
            frames = [
                f for f in traceback.extract_tb(error.__traceback__) if "palpate" in f.filename
            ]
            origin = f"{path.name} {type(error).__name__} {frames[-1].filename} {frames[-1].lineno}"
            name = hashlib.sha256(origin.encode()).hexdigest()[:12]
            if not (folder / name).exists():
                (folder / name).write_bytes(data[1:])
                (folder / f"{name}.txt").write_text(
                    f"{origin}\n{time.perf_counter() - start:.1f} s\n"
                    + "".join(traceback.format_exception(error))
                )
        finally:
            path.write_bytes(goods[number])

    atheris.Setup(sys.argv, try_one)
    atheris.Fuzz()


if __name__ == "__main__":
    _found = Path(os.environ.get("PALPATE_FUZZ_FOUND", "build/fuzz"))
    _found.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as _scratch:
        _place = Path(_scratch) / "samples"
        _place.mkdir()
        _samples = [
            (path, read)
            for path, read in write_samples(_place)
            if path.suffix not in _IN_CHILDREN and path.stat().st_size < _LARGEST
        ]
        _seeds = Path(_scratch) / "seeds"
        _seeds.mkdir()
        for _k, (_path, _) in enumerate(_samples):
            (_seeds / str(_k)).write_bytes(bytes([_k]) + _path.read_bytes())
        sys.argv.append(str(_seeds))
        _run(_samples, _found)
