"""A ball of 2562 vertices under a rigid sphere: time of a tick, of the surface, and its energy."""

import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.ball_session import write_ball_session
from benchmarks.figure import SIMULATION, Figure
from benchmarks.options import Options
from palpate.contact import ContactState, PlacedTool
from palpate.records import Sphere, read_session
from palpate.simulation import (
    GreenFunctions,
    exact_material,
    make_green_functions,
    nearest_nodes,
    start_contact,
    surface_displacement,
    touch,
)

# Nodes that may be touched, and that are to touch at the deepest.
_NODES, _TOUCHING = 400, 30
_TICKS, _WARM = 3000, 200
_KINDS = {"slides": 0.0, "Coulomb 0.3": 0.3, "sticks": np.inf}


@dataclass(frozen=True, slots=True)
class _Press:
    """A walk of a tool on an object: its states, the time of each tick [s], by the clock and as the
    processor spent it."""

    states: list[ContactState]
    seconds: Float[np.ndarray, " t"]
    busy: Float[np.ndarray, " t"]


def measure(options: Options) -> list[Figure]:
    """Ticks per second and the 99th percentile for every kind of friction; surface; energy."""
    green, touched = _ball(3 if options.quick else 4)
    ticks = 300 if options.quick else _TICKS
    figures = []
    for name, friction in _KINDS.items():
        # Once for the compiler, or for its cache.
        _walked(green, touched, friction, _WARM)
        with _real_time() as priority:
            walk = _walked(green, touched, friction, ticks)
        figures += _tick_figures(green, name, walk, priority)
    with _real_time() as priority:
        surface = _surface_figure(green, walk.states[-1], priority)
    return [*figures, surface, _energy_figure(green, touched, ticks)]


@contextmanager
def _real_time() -> Iterator[str]:
    """Real-time priority, as a haptic loop has it, where the system grants it; says which it is."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except (AttributeError, PermissionError):
        yield "at usual priority: real time was not granted"
        return
    try:
        yield "at real-time priority"
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _ball(level: int) -> tuple[GreenFunctions, Float[np.ndarray, "3"]]:
    """Green's functions around the top of a ball, and that place."""
    with tempfile.TemporaryDirectory() as folder:
        session = read_session(write_ball_session(Path(folder), level))
    top = session.mesh.vertices[session.mesh.vertices[:, 2].argmax()]
    nodes = nearest_nodes(session, top[None], _NODES)
    return make_green_functions(session, exact_material(2e4, 0.3), nodes=nodes), top


def _tool(green: GreenFunctions, top: Float[np.ndarray, "3"]) -> tuple[Sphere, float]:
    """A sphere as large as the object, and the depth at which it touches thirty nodes."""
    size = float(np.ptp(green.mesh.vertices[:, 2]))
    tool = Sphere(size)
    for depth in size * np.linspace(0.005, 0.2, 60):
        state = start_contact(green, [_placed(tool, top, -1e-6)])
        state = touch(green, [_placed(tool, top, depth)], state)
        if len(state.touching) >= _TOUCHING:
            return tool, float(depth)
    return tool, float(depth)


def _placed(
    tool: Sphere, top: Float[np.ndarray, "3"], depth: float, aside: float = 0.0
) -> PlacedTool:
    return PlacedTool(tool, top + np.array([aside, 0.0, tool.radius - depth]))


def _walked(
    green: GreenFunctions, top: Float[np.ndarray, "3"], friction: float, ticks: int
) -> _Press:
    """A press to thirty nodes, then a hand that trembles and wanders there."""
    tool, depth = _tool(green, top)
    tool = replace(tool, friction=friction)
    share = np.minimum(np.arange(ticks) / (0.3 * ticks), 1.0)
    wander = np.sin(np.linspace(0.0, 6 * np.pi, ticks)) * (share == 1.0)
    states = [start_contact(green, [_placed(tool, top, -1e-6)])]
    seconds, busy = np.zeros((2, ticks))
    for k in range(ticks):
        tremble = 1.0 + 0.02 * np.sin(0.37 * k)
        now = [_placed(tool, top, depth * share[k] * tremble, 0.3 * depth * wander[k])]
        begin, idle = time.perf_counter(), time.process_time()
        state = touch(green, now, states[-1])
        seconds[k], busy[k] = time.perf_counter() - begin, time.process_time() - idle
        states.append(state)
    return _Press(states[1:], seconds, busy)


def _tick_figures(green: GreenFunctions, name: str, walk: _Press, priority: str) -> list[Figure]:
    deep = np.array([len(state.touching) >= _TOUCHING - 3 for state in walk.states])
    deep[:_WARM] = False
    taken = walk.seconds[deep]
    of = f"tick of a sphere that {name}, {len(green.mesh.vertices)} vertices"
    touching = [
        len(state.touching) for state, is_deep in zip(walk.states, deep, strict=True) if is_deep
    ]
    note = (
        f"{deep.sum()} ticks with {min(touching)} to {max(touching)} of {len(green.nodes)} nodes"
        f" touching; warm, garbage collection included, {priority}; in processor time"
        f" {1e3 * np.percentile(walk.busy[deep], 99):.2g} ms"
    )
    return [
        Figure(
            SIMULATION, f"99th percentile, {of}", 1e3 * float(np.percentile(taken, 99)), "ms",
            note=note,
        ),
        Figure(
            SIMULATION, f"ticks per second, {of}", 1.0 / float(taken.mean()), "1/s",
            note="one over the mean of the same ticks",
        ),
    ]  # fmt: skip


def _surface_figure(green: GreenFunctions, state: ContactState, priority: str) -> Figure:
    taken = []
    for _ in range(_WARM):
        begin = time.perf_counter()
        surface_displacement(green, state)
        taken.append(time.perf_counter() - begin)
    return Figure(
        SIMULATION, f"whole surface per second, {len(green.mesh.vertices)} vertices",
        1.0 / float(np.percentile(taken, 99)), "1/s",
        note=f"{len(state.touching)} nodes touching; by the 99th percentile, {priority}",
    )  # fmt: skip


def _energy_figure(green: GreenFunctions, top: Float[np.ndarray, "3"], ticks: int) -> Figure:
    tool, depth = _tool(green, top)
    states = [start_contact(green, [_placed(tool, top, -1e-6)])]
    for share in np.linspace(0.0, 1.0, ticks):
        now = [_placed(tool, top, depth * share, 0.5 * depth * share**2)]
        states.append(touch(green, now, states[-1]))
    position = np.array([state.tools[0].position for state in states])
    push = -np.array([state.tool_force[0] for state in states])
    work = float(np.einsum("sa,sa->", 0.5 * (push[1:] + push[:-1]), np.diff(position, axis=0)))
    energy = 0.5 * float(np.einsum("na,na->", states[-1].force, states[-1].displacement))
    return Figure(
        SIMULATION, "work of the tool over energy of the object, less one", abs(work / energy - 1),
        note=f"oblique press without friction in {ticks} steps, trapezoidal rule",
    )  # fmt: skip
