"""Campaigns: speed over one process, cost of the engine, and what is left when things die.

The long study, of as many half balls as wanted, is about speed and killed workers only:

    python -m benchmarks.campaign SESSIONS
"""

import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

import dask
import distributed
import psutil

from benchmarks.clock import shortest
from benchmarks.figure import CAMPAIGN, Figure
from benchmarks.machine import ROOT
from benchmarks.options import Options
from benchmarks.report import with_notes
from palpate.campaign import DONE, FitOptions, Store, read_items, run_campaign, started_engine
from palpate.campaign.campaign import work_on_worker
from palpate.campaign.engine import Engine
from palpate.campaign.store import CampaignItem
from palpate.campaign.work import Work, do_work, pack_session
from palpate.errors import PalpateError

START = "import sys; from palpate.app.cli import main; sys.exit(main())"
_WORKER = ["--nworkers", "1", "--nthreads", "1", "--local-directory", ".", "--preload"]
TASK = 2.0  # s, of a piece of work that the engine may cost 5 % of
KILL_EVERY = 20.0  # s, between two killed workers
# A worker that notes every file it opens below the folder that the sessions lie in.
WATCH = """
import sys
def noted(what):
    with open({log!r}, "a") as file:
        file.write(what + "\\n")
def seen(event, given):
    if event == "open" and str(given[0]).startswith({home!r}):
        noted(str(given[0]))
sys.addaudithook(seen)
noted("watching")
"""


def measure(options: Options) -> list[Figure]:
    """Half balls: as many as in a small campaign, or four."""
    count = 4 if options.quick else 24
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        items = write_sessions(folder / "sessions", count)
        figures = _against_serial(items, folder)
        figures += _engine_cost(items, folder)
        figures.append(_with_kills(items, folder, every=5.0 if options.quick else KILL_EVERY))
        figures.append(_with_client_killed(items, folder))
        return figures + _without_shared_disk(items[:4], folder)


def write_sessions(folder: Path, count: int) -> tuple[CampaignItem, ...]:
    """The shipped half ball so many times, each with a line of its own in session.toml.

    Parameters
    ----------
    folder : Path             not there yet
    count : int
    """
    for number in range(count):
        copy = folder / f"ball {number:03d}"
        shutil.copytree(ROOT / "examples" / "half_ball", copy)
        with (copy / "session.toml").open("a", encoding="utf-8") as file:
            file.write(f"# {number}\n")
    return read_items(folder)


def _against_serial(items: tuple[CampaignItem, ...], folder: Path) -> list[Figure]:
    """Two workers against one process that does the same works one after the other."""
    # As in a worker: with more threads BLAS takes longer here, and sums in another order.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        process.submit(_one_after_the_other, items[0], folder / "warm").result()
        start, used = time.perf_counter(), process.submit(time.process_time).result()
        results = list(process.map(_one_after_the_other, items, repeat(folder / "serial")))
        alone = time.perf_counter() - start
        used_alone = process.submit(time.process_time).result() - used
    serial = {item.name: files for item, files in zip(items, results, strict=True)}
    with started_engine(None, 2) as workers, ExitStack() as stack:
        address = workers.client.scheduler.address
        stack.enter_context(dask.config.set(_certificates(workers.client.security)))
        # Every worker loads its programs and kernels before anything is timed.
        run_campaign(items[:4], folder / "warm-two", scheduler=address)
        start, used = time.perf_counter(), _processor_time(workers)
        rows = run_campaign(items, folder / "two", scheduler=address)
        together, used_together = time.perf_counter() - start, _processor_time(workers) - used
    equal = sum(_written(folder / "two", row.address) == serial[row.session] for row in rows)
    return [
        Figure(
            CAMPAIGN,
            "results of two workers that differ from one process in any byte",
            len(items) - equal,
            note=f"all files of {len(items)} half balls: estimate, residuals, surface",
        ),
        Figure(
            CAMPAIGN,
            f"{len(items)} sessions of the half ball, two workers over one process",
            alone / together,
            "x",
            note=f"one process {alone:.1f} s, two workers {together:.1f} s, results kept and rows"
            f" written in both, the start of the cluster left out; processor time {used_alone:.1f}"
            f" and {used_together:.1f} s: {2 * used_alone / used_together:.2f} times on free cores",
        ),
    ]


def _certificates(security: distributed.Security) -> dict[str, str]:
    """Dask's configuration for another client of a cluster of one's own."""
    config = security.get_tls_config_for_role("client")
    files = {
        "ca-file": config["ca_file"],
        "client.cert": config["cert"],
        "client.key": config["key"],
    }
    return {f"distributed.comm.tls.{name}": text for name, text in files.items()}


def _processor_time(workers: Engine) -> float:
    """Of all workers so far [s]."""
    return sum(workers.client.run(time.process_time).values())


def _one_after_the_other(item: CampaignItem, folder: Path) -> dict[str, bytes]:
    work = Work("fit", pack_session(item.path), FitOptions(), shared_body=True)
    outcome = do_work(work, folder=folder)
    store = Store(folder / "kept")
    store.begin([item])
    store.save_result(work, outcome.files)
    store.set_row(store.row_of(item, work, outcome))
    return dict(outcome.files)


def _written(campaign: Path, address: str) -> dict[str, bytes]:
    folder = campaign / "results" / address[:32]
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in ("contents.txt", "inputs.txt")
    }


def _engine_cost(items: tuple[CampaignItem, ...], folder: Path) -> list[Figure]:
    """Time of works that are refused as soon as they are unpacked, and of keeping a result."""
    works = [_refused(item) for item in items] * (200 // len(items))
    start = time.perf_counter()
    for work in works:
        with suppress(PalpateError):
            do_work(work, folder=folder / "refused")
    alone = (time.perf_counter() - start) / len(works)
    with started_engine(None, 1) as workers:
        start = time.perf_counter()
        for future in [workers.submit(work_on_worker, work, None, []) for work in works]:
            workers.wait_for_ended([future])
        through = (time.perf_counter() - start) / len(works)
    keeping, size = _keeping(items[0], folder)
    sent = sum(map(len, works[0].session.files.values()))
    cost = through - alone + keeping
    return [
        Figure(
            CAMPAIGN,
            f"what engine and folder add to a piece of work of {TASK:g} s",
            100 * cost / TASK,
            "%",
            note=f"{len(works)} works on one worker: {1e3 * (through - alone):.0f} ms each, and"
            f" {1e3 * keeping:.0f} ms to keep a result and write its row, which other workers do"
            f" not wait for; {sent / 1e3:.0f} kB there, {size / 1e3:.0f} kB back",
        ),
        Figure(
            CAMPAIGN,
            "works that one client feeds and keeps per second: workers beyond this many times the"
            " seconds of a work wait",
            1.0 / (through + keeping),
            "1/s",
            note="10 000 half balls of 5 s on 200 workers need 40 a second",
        ),
    ]


def _refused(item: CampaignItem) -> Work:
    """Work on a session of another format, its other files as they are."""
    session = pack_session(item.path)
    files = {**session.files, session.session: b'format = "none"\n'}
    return Work("fit", replace(session, files=files), FitOptions())


def _keeping(item: CampaignItem, folder: Path) -> tuple[float, int]:
    """Time to keep a result and to write its row [s]; bytes of the result."""
    work = Work("fit", pack_session(item.path), FitOptions())
    outcome = do_work(work, folder=folder / "kept-work")
    store = Store(folder / "kept")
    store.begin([item])

    def keep() -> None:
        shutil.rmtree(store.result(work), ignore_errors=True)
        store.save_result(work, outcome.files)
        store.set_row(store.row_of(item, work, outcome))

    return shortest(keep, repeats=10), sum(map(len, outcome.files.values()))


def _with_kills(items: tuple[CampaignItem, ...], folder: Path, *, every: float) -> Figure:
    """A worker of a running command is killed every so many seconds."""
    killed = 0
    process = _campaign(folder, "killed")
    last = time.monotonic()
    while process.poll() is None:
        time.sleep(0.2)
        workers = _workers_of(process.pid)
        if time.monotonic() - last > every and workers:
            os.kill(random.choice(workers), signal.SIGKILL)
            killed, last = killed + 1, time.monotonic()
    return Figure(
        CAMPAIGN,
        f"sessions without a result, a worker killed every {every:g} s",
        _missing(items, folder / "killed"),
        note=f"{len(items)} half balls, two workers, {killed} killed; exit code"
        f" {process.returncode}",
    )


def _with_client_killed(items: tuple[CampaignItem, ...], folder: Path) -> Figure:
    """The command itself is killed when a third is done, and started again."""
    done = 0
    process = _campaign(folder, "client")
    while done < len(items) // 3 and process.poll() is None:
        time.sleep(0.2)
        done = len(items) - _missing(items, folder / "client")
    workers = _workers_of(process.pid)
    process.kill()
    process.wait()
    time.sleep(2.0)
    orphans = sum(psutil.pid_exists(pid) for pid in workers)
    before = {path.name: path.stat().st_mtime_ns for path in _results(folder / "client")}
    _campaign(folder, "client").wait()
    after = {path.name: path.stat().st_mtime_ns for path in _results(folder / "client")}
    again = sum(after.get(name) != when for name, when in before.items())
    return Figure(
        CAMPAIGN,
        "sessions lost or done twice, the client killed and started again",
        _missing(items, folder / "client") + again,
        note=f"{len(before)} of {len(items)} had a result when it was killed; {orphans} workers"
        " outlived it by 2 s",
    )


def _without_shared_disk(items: tuple[CampaignItem, ...], folder: Path) -> list[Figure]:
    """Two workers with folders of their own; the scheduler is killed on the way."""
    (folder / "few").mkdir()
    for item in items:
        shutil.copytree(item.path, folder / "few" / item.path.name)
    seen, scheduler = folder / "opened.txt", f"tcp://127.0.0.1:{_free_port()}"
    watch = folder / "watch.py"
    watch.write_text(WATCH.format(home=str(folder / "few"), log=str(seen)))
    campaign = folder / "apart"
    words = ["few", "--out", "apart", "--scheduler", scheduler, "--insecure"]
    with ExitStack() as stack:
        head = stack.enter_context(_dask(["scheduler", "--port", scheduler[-5:]], folder / "s"))
        for name in ("w1", "w2"):
            stack.enter_context(_dask(["worker", scheduler, *_WORKER, str(watch)], folder / name))
        first = _palpate(["campaign", *words], folder)
        while not _results(campaign) and first.poll() is None:
            time.sleep(0.1)
        head.kill()
        _, errors = first.communicate(timeout=120)
    with ExitStack() as stack:
        stack.enter_context(_dask(["scheduler", "--port", scheduler[-5:]], folder / "s"))
        for name in ("w1", "w2"):
            stack.enter_context(_dask(["worker", scheduler, *_WORKER, str(watch)], folder / name))
        _palpate(["campaign", *words], folder).wait()
    noted = seen.read_text().splitlines()
    watching = noted.count("watching")
    return [
        Figure(
            CAMPAIGN,
            "sessions without a result, two workers without a shared disk, the scheduler killed",
            _missing(items, campaign),
            note=f"{len(items)} half balls; {watching} processes of workers, watched, opened"
            f" {len(noted) - watching} files where the sessions lie; the first run ended with code"
            f" {first.returncode}: {errors.strip()}",
        )
    ]


def _campaign(folder: Path, name: str) -> subprocess.Popen[str]:
    # Nobody reads what is said of killed workers: a pipe would fill, and the command wait.
    words = ["campaign", "sessions", "--out", name, "--workers", "2"]
    return _palpate(words, folder, stderr=subprocess.DEVNULL)


def _palpate(
    words: list[str], folder: Path, *, stderr: int = subprocess.PIPE
) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", START, *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=stderr,
        text=True,
    )


@contextmanager
def _dask(words: list[str], folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A scheduler or a worker in a folder of its own, killed at the end."""
    folder.mkdir(exist_ok=True)
    started = subprocess.Popen(
        [sys.executable, "-m", "dask", *words],
        cwd=folder,
        env={**os.environ, "TMPDIR": str(folder)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield started
    finally:
        for process in (*psutil.Process(started.pid).children(recursive=True), started):
            process.kill()
        started.wait()


def _workers_of(process: int) -> list[int]:
    """Processes of a local cluster's workers."""
    try:
        children = psutil.Process(process).children(recursive=True)
        return [child.pid for child in children if "spawn_main" in " ".join(child.cmdline())]
    except psutil.Error:
        return []


def _missing(items: tuple[CampaignItem, ...], campaign: Path) -> int:
    try:
        done = {row.session for row in Store(campaign).rows() if row.state == DONE}
    except PalpateError:
        done = set()
    return len({item.name for item in items} - done)


def _results(campaign: Path) -> list[Path]:
    below = campaign / "results"
    if not below.is_dir():
        return []
    return [path for path in below.iterdir() if not path.name.startswith(".")]


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def main() -> None:
    """Print the figures of speed and of killed workers for so many half balls."""
    count = int(sys.argv[1])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        items = write_sessions(folder / "sessions", count)
        print(with_notes(_against_serial(items, folder)), flush=True)
        print(with_notes([_with_kills(items, folder, every=KILL_EVERY)]), flush=True)


if __name__ == "__main__":
    main()
