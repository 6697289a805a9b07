"""Build description shared by pip and colcon."""

import gzip
import os
import tarfile
import time
from glob import glob
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.sdist import sdist

NAME = "geomid_ros"


class ReproducibleSdist(sdist):
    """Writes the same bytes for the same files and ``SOURCE_DATE_EPOCH``; setuptools does so for wheels alone."""

    def make_archive(self, base_name, format, root_dir=None, base_dir=None, owner=None, group=None):  # noqa: A002, ARG002
        date = int(os.environ.get("SOURCE_DATE_EPOCH", time.time()))

        def normalised(entry):
            entry.mtime, entry.uid, entry.gid, entry.uname, entry.gname = date, 0, 0, "", ""
            entry.mode = 0o755 if entry.isdir() or entry.mode & 0o100 else 0o644
            return entry

        path = Path(f"{base_name}.tar.gz")
        with (
            path.open("wb") as file,
            gzip.GzipFile("", "wb", fileobj=file, mtime=date) as packed,
            tarfile.open(mode="w", fileobj=packed, format=tarfile.PAX_FORMAT) as archive,
        ):
            archive.add(base_dir, filter=normalised)  # sorted by name
        return str(path)


SOURCES = f"{NAME}/geometry/native"
# Without a compiler the package is built without it, and numpy computes the same, more slowly. One build serves all
# versions of Python; without symbols for debuggers it does not depend on the folder in which it is built.
NATIVE = Extension(
    f"{NAME}.geometry._native",
    sources=sorted(glob(f"{SOURCES}/*.c")),
    depends=sorted(glob(f"{SOURCES}/*.h")),
    define_macros=[("Py_LIMITED_API", "0x030b0000"), ("PY_SSIZE_T_CLEAN", None)],
    extra_compile_args=["-O3", "-g0", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"],
    py_limited_api=True,
    optional=True,
)

setup(
    name=NAME,
    version="0.1.0",
    description="Geometric identification of physically consistent link inertias, online and from rosbags.",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    maintainer="geomid_ros maintainers",
    python_requires=">=3.11",
    cmdclass={"sdist": ReproducibleSdist},
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"], "": ["robots/*.urdf", "*.j2", "*.js", "*.pyi", "native/*"]},
    ext_modules=[NATIVE],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
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
        "numpy>=1.26",
        "pin",
        "pycollada",
        "rich",
        "rosbags",
        "scipy>=1.11",
        "trimesh",
    ],
    extras_require={
        "dashboard": ["tornado"],
        "docs": ["latex2mathml", "mkdocs", "mkdocs-material", "mkdocstrings-python", "ruff"],
        "fleet": ["dask[distributed]", "fsspec[http]"],
        "ros": ["ros-jazzy-common-interfaces", "ros-jazzy-rclpy[fastrtps]"],
        "simulate": ["mujoco"],
        "test": ["build", "example-robot-data", "hypothesis", "pyriemann", "pytest", "pytest-timeout", "safetensors"],
        "xacro": ["xacro"],
    },
    entry_points={
        "console_scripts": [
            f"geomid = {NAME}.commands:main",
            f"geomid_node = {NAME}.ros.main:main",
            f"geomid_feedforward = {NAME}.ros.feedforward:main",
        ],
    },
)
