"""What a trace counts: calls between files of the package, by function and by room."""

import sys

from benchmarks.trace_fit import Trace, summary
from palpate.records import length_unit, value_text
from palpate.records.estimate import Constant


def test_calls_within_a_file_and_from_outside_are_no_moves():
    trace = Trace()
    sys.setprofile(trace.profile)
    length_unit(1.0)
    value_text(Constant(1.0, 0.1, (0.5, 1.5)))
    sys.setprofile(None)
    # The tests are not of the package; value_text calls _places in its own file.
    assert trace.files == {"records/quantities.py", "records/estimate.py"}
    assert not trace.moves


def test_moves_are_counted_once_and_every_time_and_by_room():
    trace = Trace({"a/x.py", "a/y.py", "b/z.py"})
    trace.moves.update(
        {("a/x.py", "f", "a/y.py", "g"): 3, ("a/x.py", "f", "b/z.py", "h"): 4,
         ("a/x.py", "k", "b/z.py", "h"): 1}
    )  # fmt: skip
    assert summary(trace) == [
        "files entered: 3",
        "moves, every call: 8, between rooms 5",
        "moves, each pair of functions once: 3, between rooms 2",
        "moves, each pair of files once: 2, between rooms 1",
    ]
