"""A simulated quadruped with an IMU and no force sensors: how far an identification is from the truth.

    python -m benchmarks.legs ROBOT.urdf [--seeds 3] [--imu-turned DEG] [--imu-off M] [--gaits trot]

Errors are those of the wrench on the base and of the joints' efforts on another motion of the same robot, as the
identified and the true links predict them, so they hold no noise; of the estimate, and of the links fitted for a plain
URDF and for MuJoCo.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from defusedxml import ElementTree

from geomid_ros.api.identify import Identification, identify
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.readers import MUJOCO, URDF
from geomid_ros.geometry.pseudo_inertia import parameter_transform
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.session.recordings import Topics, read_samples
from geomid_ros.simulation.walking import WalkOptions, simulate_walk
from geomid_ros.types import FloatArray

FEET = {f"{leg}_foot": 0.022 for leg in ("FL", "FR", "RL", "RR")}
CONTACTS = [f"{foot}:{radius}" for foot, radius in FEET.items()]
IMU = "imu"
_OTHER_MOTION = 1000  # added to the seed


def true_parameters(robot: Robot, truth: Path) -> FloatArray:
    """The true parameters ``(bodies, 10)`` of a simulated robot's bodies."""
    links = {link["name"]: link for link in json.loads(truth.read_text(encoding="utf-8"))["links"]}
    found = np.zeros((len(robot.bodies), 10))
    for index, body in enumerate(robot.bodies):
        for name in links.keys() & {body.name, *body.merged}:
            placed = robot.fixed_placement(name, body.name)
            found[index] += parameter_transform(placed[:3, :3], placed[:3, 3]) @ _parameters(links[name])
    return found


def _parameters(link: dict[str, Any]) -> FloatArray:
    mass, com, inertia = link["mass"], np.array(link["com"]), np.array(link["inertia"])
    about_origin = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
    xx, xy, xz, yy, yz, zz = about_origin[np.triu_indices(3)]
    return np.array([mass, *(mass * com), xx, xy, yy, xz, yz, zz])


def errors(robot: Robot, found: FloatArray, true: FloatArray, samples: Samples) -> dict[str, float]:
    """RMS error of the base's force [N] and moment [N m] and of the joints' efforts [N m], of masses [kg], and of the
    trunk's centre of mass [mm]."""
    rows = robot.joint_effort_rows(*robot.configuration(samples), base=True)
    wrong = np.einsum("ncbk,bk->nc", rows, found - true)
    trunk = robot.body_names.index(robot.tree.root)
    com, true_com = found[trunk, 1:4] / found[trunk, 0], true[trunk, 1:4] / true[trunk, 0]
    return {
        "base N": _rms(wrong[:, -6:-3]),
        "base N m": _rms(wrong[:, -3:]),
        "joints N m": _rms(wrong[:, :-6]),
        "total kg": float(np.sum(found[:, 0] - true[:, 0])),
        "trunk %": 100.0 * float(found[trunk, 0] / true[trunk, 0] - 1.0),
        "com mm": 1e3 * float(np.linalg.norm(com - true_com)),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2) * values.shape[1]))


def misplaced(urdf: str, turned: float, off: float) -> str:
    """The description with the IMU turned about its x by ``turned`` [rad] and ``off`` along x [m] from where it is."""
    tree = ElementTree.fromstring(urdf)
    (origin,) = tree.findall(f"joint[@name='{IMU}_joint']/origin")
    x, y, z = map(float, origin.get("xyz", "0 0 0").split())
    origin.attrib |= {"xyz": f"{x + off} {y} {z}", "rpy": f"{turned} 0 0"}
    return ElementTree.tostring(tree, encoding="unicode")


def identified(bag: Path, urdf: str, cutoff: float) -> Identification:
    """What the package makes of a recording."""
    return identify(bag, urdf=urdf, imu=f"/imu:{IMU}", contacts=CONTACTS, cutoff=cutoff)


def other_motion(result: Identification, bag: Path) -> Samples:
    """The samples of another recording."""
    session = result.session
    with Bag(bag) as opened:
        topics = Topics("joint_states", "odom", "/imu")
        return Samples.concatenate(list(read_samples(opened, session, session.new_pipeline(), topics)))


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("urdf", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--gaits", nargs="+", default=["wobble", "lift", "trot"])
    parser.add_argument("--duration", type=float, default=36.0)
    parser.add_argument("--cutoff", type=float, default=15.0)
    parser.add_argument("--imu-turned", type=float, default=0.0, help="[deg]")
    parser.add_argument("--imu-off", type=float, default=0.0, help="[m]")
    options = parser.parse_args()
    for seed in options.seeds:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            walk = {"robot": str(options.urdf), "feet": FEET, "imu": IMU, "seed": seed}
            bag, truth = simulate_walk(
                folder / "walk", WalkOptions(**walk, gaits=options.gaits, duration=options.duration)
            )
            other, _ = simulate_walk(
                folder / "other", WalkOptions(**walk, motion_seed=seed + _OTHER_MOTION, duration=24.0)
            )
            urdf = misplaced(options.urdf.read_text(), np.deg2rad(options.imu_turned), options.imu_off)
            result = identified(bag, urdf, options.cutoff)
            robot = result.session.robot
            samples, true = other_motion(result, other), true_parameters(robot, truth)
            model = result.session.model
            known = {"URDF": model.nominal_parameters, "found": result.estimate.parameters}
            for label, parameters in (known | {name: result.estimate.within[name] for name in (URDF, MUJOCO)}).items():
                found = errors(robot, parameters[: true.size].reshape(-1, 10), true, samples)
                print(f"seed {seed} {label:6}", "  ".join(f"{key} {value:7.3f}" for key, value in found.items()))
            (trunk,) = (link for link in result.links if link.name == robot.tree.root)
            off = (trunk.mass - true[robot.body_names.index(trunk.name), 0]) / trunk.std_mass
            print(f"the trunk's mass is off by {off:.1f} of its standard deviations")
            print(result.verdict.word, *result.verdict.reasons, *result.warnings, sep="\n   ", flush=True)


if __name__ == "__main__":
    main()
