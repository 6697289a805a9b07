"""MuJoCo's warnings."""

from __future__ import annotations

from pathlib import Path

import pytest

from geomid_ros.resimulation.written_robot import load_mujoco

SPINNING = "<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>"


def test_a_run_that_diverges_leaves_no_file_and_prints_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    mujoco = load_mujoco()
    model = mujoco.MjModel.from_xml_string(SPINNING)
    data = mujoco.MjData(model)
    data.qvel[0] = 1e12
    mujoco.mj_step(model, data)
    assert sum(data.warning.number) == 1
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")
