"""What a trace counts: functions in the order in which they are entered, by file and by room."""

from benchmarks.trace_fit import Trace, room, traced
from palpate.records import length_unit, value_text
from palpate.records.estimate import Constant


def test_functions_are_listed_in_order_and_those_of_others_are_not():
    def work() -> None:
        length_unit(1.0)
        value_text(Constant(1.0, 0.1, (0.5, 1.5)))

    entered = traced(work)
    # The constant is made before the text; both texts come from one file, its helpers included.
    assert list(dict.fromkeys(entered)) == ["records/quantities.py", "records/estimate.py"]
    assert entered[0] == entered[-1] == "records/quantities.py"


def test_moves_are_neighbours_in_different_files_and_rooms():
    trace = Trace.of(["a/x.py", "a/x.py", "a/y.py", "b/z.py", "errors.py", "threads.py", "b/z.py"])
    # x to y, y to z, z to errors, errors to threads, threads to z; the ground floor is one room.
    assert (trace.files, trace.moves, trace.between_rooms) == (5, 5, 3)
    assert (trace.routes, trace.routes_between_rooms) == (5, 3)
    # There and back, twice.
    assert Trace.of(["a/x.py", "b/z.py"] * 2 + ["a/x.py"]) == Trace(2, 4, 4, 2, 2)


def test_the_ground_floor_is_one_room():
    assert room("arrays.py") == room("threads.py")
    assert room("vision/projection.py") == room("vision/range_flow.py") == "vision"
