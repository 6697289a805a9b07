"""Build description shared by pip and colcon."""

from glob import glob

from setuptools import find_packages, setup

NAME = "geomid_ros"

setup(
    name=NAME,
    version="0.1.0",
    description="Geometric identification of physically possible link inertias, online and from rosbags.",
    license="Apache-2.0",
    maintainer="geomid_ros maintainers",
    maintainer_email="maintainers@geomid-ros.example",
    python_requires=">=3.11",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"], "": ["*.urdf", "*.j2", "*.js"]},
    zip_safe=False,
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.*"))),
        (f"share/{NAME}/security", sorted(glob("security/*"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{NAME}/bags", sorted(glob("bags/*.*"))),
        *((f"share/{NAME}/{bag}", sorted(glob(f"{bag}/*"))) for bag in ("bags/arm3", "bags/arm7")),
    ],
    install_requires=[
        "PyYAML",
        "click",
        "backports.zstd; python_version < '3.14'",
        "defusedxml",
        "jinja2",
        "lz4",
        "manifold3d",
        "matplotlib",
        "numba",
        "numpy>=1.26",
        "pin",
        "pycollada",
        "rich",
        "rosbags",
        "scipy>=1.11",
        "trimesh",
    ],
    extras_require={
        "fleet": ["dask[distributed]", "fsspec[http]"],
        "ros": ["ros-jazzy-common-interfaces", "ros-jazzy-rclpy[fastrtps]"],
        "simulate": ["mujoco"],
        "test": ["example-robot-data", "hypothesis", "pyriemann", "pytest"],
        "xacro": ["xacro"],
    },
    entry_points={
        "console_scripts": [
            f"geomid = {NAME}.commands.root:main",
            f"geomid_node = {NAME}.ros.main:main",
        ],
    },
)
