"""MuJoCo, imported when it is first needed."""

from __future__ import annotations

import importlib
from typing import Any

from geomid_ros.errors import InputError


def load_mujoco() -> Any:
    """The module. Raises InputError when it does not import."""
    try:
        mujoco = importlib.import_module("mujoco")
    except ImportError as error:
        raise InputError(f"simulating needs MuJoCo, which does not import ({error}): pip install mujoco") from error
    # By itself it prints them and leaves a MUJOCO_LOG.TXT where the user happens to be; the figures say it better.
    mujoco.set_mju_user_warning(_pass_over)
    return mujoco


def _pass_over(_: str) -> None:
    """Warnings are of runs that diverge, whose figures show that."""


def load_rollout() -> Any:
    """MuJoCo's module for many runs at once."""
    return importlib.import_module("mujoco.rollout")
