from glob import glob

from setuptools import find_packages, setup

PACKAGE = "mother_rover"

# The commands on PATH. Nodes are not: scripts/<node> is installed into lib/mother_rover, where
# `ros2 run` looks for it, and starts `bin/mother_rover run <node>` of the same prefix.
CONSOLE_SCRIPTS = {
    "mother_rover": "rover_cli.command_line:main",
    "rover": "operator_console.command_line:main",
}

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Simulator and control suite for a tethered lunar rover, as ROS 2 Jazzy nodes",
    maintainer="mother_rover maintainers",
    maintainer_email="maintainers@mother-rover.example",
    license="Apache-2.0",
    python_requires=">=3.11,<3.13",
    packages=find_packages(),
    package_data={
        "": ["py.typed"],
        "rover_runtime.ros": ["loopback.xml", "network.xml", "interfaces/*/*/*"],
        "rover_bags.views": ["*.css", "*.js"],
        "operator_console": ["page/*", "page/vendor/uplot/*"],
        "rover_control.mission": ["plans/*.yaml"],
        "rover_hil.canopen": ["eds/*.eds"],
        "rover_hil.rehearsal": ["procedures/*.yaml"],
        "rover_sim.scenarios": ["*.yaml", "bases/*.yaml"],
        "rover_verify.requirements": ["*.yaml"],
    },
    data_files=[
        ("lib/" + PACKAGE, sorted(glob("scripts/*"))),
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
        ("share/" + PACKAGE + "/launch", sorted(glob("launch/*.launch.py"))),
        ("share/" + PACKAGE + "/config", sorted(glob("config/*"))),
    ],
    entry_points={
        "console_scripts": [f"{name}={target}" for name, target in CONSOLE_SCRIPTS.items()],
        # So that other tools of python-can read our serial lines too.
        "can.interface": ["cobs_serial=rover_hil.canopen.serial_bus:CobsSerialBus"],
    },
    install_requires=[
        "ros-jazzy-rclpy[fastrtps]>=7.1,<8",
        "ros-jazzy-common-interfaces>=5.3,<6",
        "argcomplete>=3.1",
        "canopen>=2.3",
        "cobs>=1.2",
        "lz4>=4.0",
        "matplotlib>=3.6",
        "mcap>=1.5",
        "mcap-ros2-support>=0.5",
        "numba>=0.59,<0.70",
        "numpy>=1.26",
        "pillow>=9.4",
        "pyarrow>=14.0,<26",  # 26 refuses numpy 1.26, which Ubuntu 24.04 has
        "pyserial>=3.5",
        "python-can[multicast]>=4.3",
        "pyyaml>=6.0",
        "rich>=13.7",
        "rosbags>=0.11",
        "scipy>=1.11",
        "tornado>=6.4",
        "tqdm>=4.64",
        "zstandard>=0.20",
    ],
    extras_require={
        "test": [
            "dask[distributed]>=2024.5",
            "hypothesis>=6.98",
            "junitparser>=3.1",
            "pandas>=2.1",
            "playwright>=1.40",
            "pytest>=7.4",
            "pytest-timeout>=2.2",
            "pytest-xdist>=3.4",
            "urdf-parser-py>=0.0.4",
        ],
        "fuzz": ["atheris>=3.0"],
        "cluster": ["dask[distributed]>=2024.5"],
        "bench": ["exudyn>=1.8"],
        "docs": [
            "furo>=2024.8",
            "mermaidx>=0.10",
            "myst-parser>=4",
            "sphinx>=7.4",
            "sphinx-copybutton>=0.5",
            "sphinx-mathjax-offline>=0.0.2",
            "sphinxcontrib-mermaid>=1.0",
        ],
        "dev": [
            "mypy~=2.4",
            "pre-commit>=3.7",
            "pytest-cov>=5",
            "ruff~=0.17.5",
            "scipy-stubs",
            "types-PyYAML",
        ],
    },
    zip_safe=False,
)
