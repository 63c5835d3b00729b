"""Every thing is done once, whatever the number of threads, and errors come through."""

import threading
import time

import numba
import numpy as np
import pytest

from palpate.threads import in_threads, map_in_threads


@pytest.fixture(params=[1, 2])
def threads(request):
    if request.param > numba.config.NUMBA_NUM_THREADS:
        pytest.skip("needs two threads")
    before = numba.get_num_threads()
    numba.set_num_threads(request.param)
    yield request.param
    numba.set_num_threads(before)


@pytest.mark.parametrize("count", [0, 1, 7, 100])
@pytest.mark.parametrize("min_items", [1, 30])
def test_every_thing_is_done_once(threads, count, min_items):
    done = np.zeros(count, dtype=int)

    def kernel(start, stop, amount):
        done[start:stop] += amount

    in_threads(kernel, count, 3, min_items=min_items)
    np.testing.assert_array_equal(done, 3)


def test_the_kernel_is_first_called_for_nothing():
    ranges = []
    in_threads(lambda start, stop: ranges.append((start, stop)), 5, min_items=5)
    assert ranges == [(0, 0), (0, 5)]


def test_two_threads_work_at_the_same_time(threads):
    # Each of two ranges waits for the other one: alone, either would wait in vain.
    together = threading.Barrier(threads)

    def kernel(start, stop):
        if stop > start:
            together.wait(timeout=30.0)

    in_threads(kernel, threads, min_items=1)


def test_an_error_in_a_thread_comes_through(threads):
    def kernel(start, stop):
        if stop == 8:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        in_threads(kernel, 8)


def test_results_come_in_the_order_of_the_items(threads):
    results = map_in_threads(
        lambda x, y: (time.sleep(x), x + y)[1], [0.02, 0.0, 0.01], [1.0, 2.0, 3.0]
    )
    assert list(results) == [1.02, 2.0, 3.01]


def test_the_error_of_an_item_is_raised_at_its_turn(threads):
    results = map_in_threads(lambda x: 1 // x, [1, 0, 2])
    assert next(results) == 1
    with pytest.raises(ZeroDivisionError):
        next(results)
