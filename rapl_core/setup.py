"""Packaging of rapl_core, for pip and for colcon."""

from setuptools import find_packages, setup

setup(
    name="rapl_core",
    version="0.1.0",
    description="Algorithms, worlds and learning of RAPL; knows nothing of ROS",
    author="RAPL",
    author_email="rapl@example.org",
    license="Apache-2.0",
    python_requires=">=3.11",
    package_dir={"": "."},  # an editable install is then one .pth line, not an import hook
    packages=find_packages(include=["rapl_core", "rapl_core.*"]),
    package_data={
        "rapl_core": ["py.typed"],
        "rapl_core.analysis": ["*.html"],
        "rapl_core.episodes": ["messages/*/msg/*.msg"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/rapl_core"]),
        ("share/rapl_core", ["package.xml"]),
    ],
    zip_safe=False,
    entry_points={"console_scripts": ["rapl = rapl_core.cli:main"]},
)
