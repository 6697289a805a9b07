"""The node as a release of ROS has it, without what PyPI alone has: ``python -m ros.bare``."""

from __future__ import annotations

import sys
from typing import Any

FROM_PYPI = ("rosbags", "lz4", "backports", "trimesh", "manifold3d", "mujoco")


class Refusal:
    """A finder that finds none of them."""

    def find_spec(self, name: str, *_: Any) -> None:
        if name.partition(".")[0] in FROM_PYPI:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


if __name__ == "__main__":
    for module in [name for name in sys.modules if name.partition(".")[0] in FROM_PYPI]:
        del sys.modules[module]
    sys.meta_path.insert(0, Refusal())  # type: ignore[arg-type]

    from geomid_ros.ros.main import main

    main()
