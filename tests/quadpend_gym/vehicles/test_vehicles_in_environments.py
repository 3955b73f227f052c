"""Vehicles from presets and files reach the environment, its specification and its pictures."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_gym.vehicles import VEHICLES
from quadpend_train.cli.main import main
from tests.quadpend_gym.vehicles.test_bad_vehicles import changed

ID = "quadpend_gym:QuadPendulum-v0"


def test_the_picture_shows_the_thrust_that_the_rotors_have_reached() -> None:
    env: Any = gym.make(ID, vehicle="hummingbird", interface="rotors", render_mode="rgb_array")
    env.reset(seed=0)
    most = 4.0 * 3.8 / VEHICLES["hummingbird"].weight
    assert_allclose(env.unwrapped.recorder.snapshot().thrust, 1.0, atol=1e-9)
    env.step(np.ones(4, np.float32))
    share = 1.0 - np.exp(-0.01 / 0.015)  # the lag after a control period
    assert_allclose(env.unwrapped.recorder.snapshot().thrust, 1.0 + share * (most - 1.0), rtol=0.02)


@pytest.mark.parametrize("line", ["mass = 5000", "mas = 0.5"])
def test_the_command_line_refuses_a_senseless_vehicle_with_one_sentence(
    line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(changed("mass", line))
    with pytest.raises(SystemExit) as caught:
        main(["evaluate", "lqr", "--scenarios", "calm", "--vehicle", "mine.toml"])
    printed = capsys.readouterr()
    assert caught.value.code == 2
    assert printed.err.startswith("quadpend: ")
    assert "mine.toml" in printed.err
    assert printed.err.count("\n") == 1
    assert printed.out == ""
