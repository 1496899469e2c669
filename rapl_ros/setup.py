"""Packaging of rapl_ros, for pip and for colcon."""

from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).parent
NODES = sorted(path.stem.removesuffix("_node") for path in HERE.glob("rapl_ros/*_node.py"))

setup(
    name="rapl_ros",
    version="0.1.0",
    description="The nodes of RAPL: thin shells over rapl_core",
    author="RAPL",
    author_email="rapl@example.org",
    license="Apache-2.0",
    python_requires=">=3.11",
    package_dir={"": "."},  # an editable install is then one .pth line, not an import hook
    packages=find_packages(include=["rapl_ros", "rapl_ros.*"]),
    package_data={"rapl_ros.web": ["static/*", "static/*/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/rapl_ros"]),
        ("share/rapl_ros", ["package.xml"]),
    ],
    zip_safe=False,
    # What `ros2 run rapl_ros` finds; each runs the module of its name.
    entry_points={"console_scripts": [f"{node} = rapl_ros.executables:run" for node in NODES]},
)
