"""Measures one subject and prints its figures as a line of JSON: what `run.py` starts."""

import argparse
import importlib
import json

from benchmarks.figure import plain
from benchmarks.options import Options


def main() -> None:
    """Every subject is a module of this folder with `measure(options)`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measure")
    parser.add_argument("subject")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--peers", action="store_true")
    given = parser.parse_args()
    subject = importlib.import_module(f"benchmarks.{given.subject}")
    figures = subject.measure(Options(quick=given.quick, peers=given.peers))
    print(json.dumps(plain(figures)))


if __name__ == "__main__":
    main()
