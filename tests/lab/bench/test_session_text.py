"""Sessions and truths as TOML: read again by the standard reader, nothing lost."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from lab.lab_configs import HALF_BALL, STAGE

from palpate.lab import Sensor, read_lab_config
from palpate.lab.facility import probe_tables, step_tables, write_session
from palpate.solids import TIPS, Press


@pytest.fixture
def written(tmp_path):
    """Writes a measurement that a configuration and a function of it give; reads both files."""

    def writer(text, measure, **changes):
        (tmp_path / "config.toml").write_text(text)
        config = replace(read_lab_config(tmp_path / "config.toml"), **changes)
        write_session(tmp_path, config, measure(config))
        return [
            tomllib.loads((tmp_path / name).read_text(encoding="utf-8"))
            for name in ("session.toml", "truth.toml")
        ]

    return writer


def _pressed(config):
    """One probing to two depths, every number with all its digits."""
    (probe,) = config.probes
    rng = np.random.default_rng(0)
    tip = TIPS["sphere"](6e-3, np.array([0.0, 0.0, 0.046]), np.array([0.1, -0.2, -0.9]))
    load = np.zeros((1, 3))
    states = [
        Press(depth, tip.point, rng.normal(size=3), 1.0 / 300.0, load, load)
        for depth in (1e-3, 3e-3)
    ]
    return [probe_tables(config, probe, tip, states, rng=rng)]


def test_a_probing_comes_back_digit_by_digit(written):
    name = 'a "quoted" \\ name\nwith ümlauts'
    session, truth = written(HALF_BALL, _pressed, name=name)
    assert session["name"] == name
    assert session["support"]["plane"] == {"point": [0, 0, 0], "normal": [0, 0, 1],
                                           "tolerance": 1e-9}  # fmt: skip
    (probe,), (true,) = session["probe"], truth["probe"]
    assert probe["contact"] == {"point": [0.0, 0.0, 0.04], "tool": "sphere",
                                "tool_radius": 6e-3, "friction": "slides"}  # fmt: skip
    assert probe["images"]["loaded"] == ["images/n01_1_{camera}.png", "images/n01_{camera}.png"]
    rng = np.random.default_rng(0)
    assert true["force"] == rng.normal(size=(2, 3))[1].tolist()
    assert true["load_steps"] == [1e-3 / 3e-3, 1.0]
    assert (true["depth"], true["contact_radius"]) == (3e-3, 1.0 / 300.0)
    assert (truth["seed"], truth["law"]) == (3, "linear")
    assert (probe["force_std"], probe["tip_displacement_std"]) == (0.002, 5e-5)


def test_perfect_sensors_state_no_standard_deviation(written):
    perfect = {"force_sensor": Sensor(), "position_sensor": Sensor()}
    session, truth = written(HALF_BALL, _pressed, **perfect)
    (probe,) = session["probe"]
    assert {"force_std", "tip_displacement_std"}.isdisjoint(probe)
    assert probe["force"] == truth["probe"][0]["force"]


def test_a_step_comes_back_and_has_no_support(written):
    motion = np.eye(4)
    motion[:3] = np.random.default_rng(1).normal(size=(3, 4))
    session, truth = written(
        STAGE, lambda config: [step_tables(config, "s1", motion, rng=np.random.default_rng(0))]
    )
    assert "support" not in session
    assert session["step"] == [{"name": "s1", "images": "images/s1_{camera}.png"}]
    (step,) = truth["step"]
    assert step["R"] == motion[:3, :3].tolist()
    assert step["t"] == step["encoder"] == motion[:3, 3].tolist()
