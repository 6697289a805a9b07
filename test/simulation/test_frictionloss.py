"""MuJoCo's dry friction is the ramp that ``coulomb_friction`` with ``creep`` is."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.model.effects.coulomb_friction import CoulombFriction
from geomid_ros.model.effects.situation import JointMotion

LEVEL, TIME, INERTIA = 3.0, 0.02, 0.05
LEAST, MOST = 0.9, 0.95  # MuJoCo's usual impedance
MODEL = f"""
<mujoco>
  <option gravity="0 0 0" timestep="0.002" tolerance="1e-14"/>
  <worldbody>
    <body>
      <joint axis="0 0 1" frictionloss="{LEVEL}" solreffriction="{TIME} 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 {INERTIA}"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("share", [-3.0, -1.0, -0.6, -0.1, 0.0, 0.3, 0.9, 1.0, 2.0])
def test_it_balances_the_ramp_at_a_constant_speed(share: float) -> None:
    """The joint creeps without acceleration under exactly that effort."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    creep = LEVEL * (1.0 - LEAST) / LEAST / INERTIA / (2.0 / (MOST * TIME))
    data.qvel[0] = speed = share * creep
    motion = JointMotion(np.zeros(1), np.array([speed]), np.zeros(1))
    data.qfrc_applied[0] = LEVEL * CoulombFriction(creep=creep).column(motion)[0]
    mujoco.mj_forward(model, data)
    assert data.qacc[0] == pytest.approx(0.0, abs=1e-6 * LEVEL / INERTIA)
