from glob import glob

from setuptools import find_packages, setup

NAME = "pkm_cnc"
NODES = (
    *("interpolator", "inverse_kinematics", "servo_drive", "plant", "tcp_controller", "contour_monitor", "recorder"),
    "compensation_preprocessor",
)

setup(
    name=NAME,
    version="0.1.0",
    description="CNC controller of a parallel kinematic machine, as a ROS 2 graph and as a simulation without ROS",
    maintainer="pkm_cnc maintainers",
    maintainer_email="pkm-cnc@example.org",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.yaml"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{NAME}/programs", sorted(glob("programs/*.ngc"))),
    ],
    zip_safe=False,
    install_requires="numpy scipy pyyaml rosbags mcap zstandard matplotlib plotly joblib rich scikit-learn".split(),
    extras_require={"cluster": ["distributed"]},
    entry_points={
        "console_scripts": [f"{NAME} = {NAME}.cli:main", *(f"{node} = {NAME}.nodes.{node}:main" for node in NODES)]
    },
)
