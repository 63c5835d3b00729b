"""Measuring live: devices, and the guided way from plugged-in devices to constants.

Purpose    : drive cameras, a gauge and an arm, or guide a person, push after push, until the
             constants are known as well as wanted.
Takes      : bench.toml, or a configuration of the virtual laboratory; answers to questions.
Gives      : a session's folder that is whole after each push, and its `Estimate`.
Depends on : `viewer`, `figures`, `pipeline`, `calibration`, `recording`,
             `scanning`, `lab`, `solids`, `vision`, `records`, `geometry`.
Read first : `devices.py`, `questions.py`, `measure.py`, then `pushing.py`, `calibrating.py`,
             `turning.py`, `page.py`.
"""

from palpate.bench.bench_file import (
    Bench as Bench,
    read_bench as read_bench,
    virtual_bench as virtual_bench,
)
from palpate.bench.devices import (
    Arm as Arm,
    Camera as Camera,
    DeviceError as DeviceError,
    ForceSource as ForceSource,
)
from palpate.bench.measure import measure as measure
from palpate.bench.page import Page as Page
from palpate.bench.questions import Questions as Questions
from palpate.bench.virtual import DrawnBody as DrawnBody
from palpate.bench.wanted import Wanted as Wanted, wanted_precision as wanted_precision
