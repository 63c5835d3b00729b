"""Waiting for what other threads and a browser bring about."""

import time


def until(condition, patience=60.0):
    """Wait until a condition holds; fail where it does not in time."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.05)
