"""Installation by pip and by colcon. Version, description and maintainer are those of package.xml."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import Distribution, find_packages, setup

package = ElementTree.parse("package.xml").getroot()
name = package.findtext("name")
maintainer = package.find("maintainer")


def files(pattern: str) -> list[str]:
    return sorted(str(path) for path in Path().glob(pattern))


class WithData(Distribution):
    """Puts the data files into an editable installation too: setuptools asks for them under a name that it lacks."""

    has_data = Distribution.has_data_files


setup(
    distclass=WithData,
    name=name,
    version=package.findtext("version"),
    description=package.findtext("description"),
    license=package.findtext("license"),
    maintainer=maintainer.text,
    maintainer_email=maintainer.get("email"),
    python_requires=">=3.10",
    packages=find_packages(include=[name, f"{name}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (f"share/{name}", ["package.xml"]),
        (f"share/{name}/launch", files("launch/*.launch.py")),
        (f"share/{name}/config", files("config/*.yaml")),
        (f"share/{name}/layouts", files("layouts/*")),
    ],
    # rclpy and the messages come from ROS, or from requirements.txt
    install_requires=[
        "bokeh>=3.4",
        "filterpy>=2",
        "lz4>=4",
        "mcap>=1.2",
        "numba>=0.58",
        "numpy>=1.26",
        "pillow>=10",
        "pyarrow>=15",
        "pyyaml>=6",
        "rich>=13",
        "rosbags>=0.10",
        "scipy>=1.15",
        "typer>=0.9",
        "zstandard>=0.22",
    ],
    extras_require={
        "dask": ["distributed>=2024.8"],
        "notebook": ["matplotlib>=3.8", "pandas>=2.2"],
        "pictures": ["matplotlib>=3.8"],
        "sumo": ["eclipse-sumo>=1.20"],  # for a test only
        "xarray": ["xarray>=2024.7"],
    },
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"sugiyama = {name}.cli:main",
            *(
                f"sugiyama_{node} = {name}.nodes.executables:{node}"
                for node in ("critic", "drivers", "keeper", "recorder", "replay", "simulator", "tracks")
            ),
        ]
    },
)
