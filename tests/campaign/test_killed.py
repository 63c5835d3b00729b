"""A campaign whose process dies, at any step of its writing: it goes on, and nothing is lost."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
from fault_injection import all_states

from palpate.campaign import Row, campaign as campaign_file, read_items, run_campaign
from palpate.campaign.work import Outcome, Work, do_work
from palpate.errors import PalpateError


class _Serial:
    """Works one after the other in this process, each done only once for all runs."""

    threads = 1

    def __init__(self, folder: Path, known: dict[str, Outcome]) -> None:
        self.folder, self.known = folder, known
        self.submitted: list[Work] = []

    def submit(self, _: object, work: Work, *__: object) -> int:
        self.submitted.append(work)
        return len(self.submitted) - 1

    def wait_for_ended(self, futures: Iterable[int]) -> list[int]:
        return [min(futures)]

    def result(self, future: int) -> Outcome | PalpateError:
        work = self.submitted[future]
        if work.digest not in self.known:
            try:
                self.known[work.digest] = do_work(work, folder=self.folder)
            except PalpateError as error:
                return error
        return self.known[work.digest]


def _results(folder: Path) -> dict[str, bytes]:
    """Estimates and surfaces; other files tell times, and the way to the sessions."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix in (".json", ".npz")
    }


def _constants(rows: Sequence[Row]) -> list[tuple[object, ...]]:
    return [(row.session, row.state, row.young_modulus, row.message, row.address) for row in rows]


def test_wherever_it_is_killed_it_goes_on(
    cubes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known: dict[str, Outcome] = {}

    @contextmanager
    def started(*_: object, **__: object) -> Iterator[_Serial]:
        yield _Serial(tmp_path / "worker", known)

    monkeypatch.setattr(campaign_file, "started_engine", started)
    items, whole = read_items(cubes), tmp_path / "whole"
    rows = run_campaign(items, whole)
    assert [row.state for row in rows] == ["failed", "done", "done"]
    constants = _constants(rows)
    work, copies = tmp_path / "campaign", tmp_path / "copies"
    work.mkdir()

    def differs() -> bool:
        return _constants(run_campaign(items, work / "c")) != constants

    assert all_states(differs, work, copies)
    states = sorted(path for path in copies.iterdir() if path.is_dir())
    assert len(states) > 20
    for state in states:
        before = _results(state / "c")
        # What is there is a whole result, or hidden.
        shown = {name: text for name, text in before.items() if "/." not in f"/{name}"}
        assert shown.items() <= _results(whole).items()
    for state in states[:: max(len(states) // 8, 1)]:
        assert _constants(run_campaign(items, state / "c")) == constants
        assert _results(state / "c") == _results(whole)
