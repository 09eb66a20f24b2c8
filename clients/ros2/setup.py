"""For colcon: an ament_python package."""

from setuptools import setup

NAME = "qrsim_ros2"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/rviz", ["rviz/qrsim.rviz"]),
    ],
    install_requires=["setuptools"],
    license="BSD-3-Clause",
    entry_points={"console_scripts": [f"services = {NAME}.services:main", f"forward = {NAME}.forward:main"]},
)
