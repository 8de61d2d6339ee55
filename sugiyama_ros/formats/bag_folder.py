"""Directories of rosbag2: one or more files, and ``metadata.yaml``."""

from pathlib import Path

from sugiyama_ros.documents import read_yaml
from sugiyama_ros.errors import InputError

METADATA = "metadata.yaml"


def bag_files(path: Path) -> list[Path]:
    """Files of a bag, in the order in which they were recorded.

    Parameters
    ----------
    path : Path
        MCAP file, or directory of rosbag2.

    Returns
    -------
    list of Path
        The file itself, or the files of the directory.

    Raises
    ------
    InputError
        For a directory that is no bag, or whose files are not MCAP.
    """
    if not path.is_dir():
        return [path]
    document = read_yaml(path / METADATA)
    try:
        about = document["rosbag2_bagfile_information"]
        storage, names = str(about["storage_identifier"]), [str(name) for name in about["relative_file_paths"]]
    except (KeyError, TypeError):
        raise InputError(f"{path / METADATA}: is not of a bag; give a directory that rosbag2 recorded") from None
    if storage != "mcap":
        raise InputError(f"{path}: its storage is {storage}, not mcap; convert it with `ros2 bag convert`")
    files = [path / Path(name).name for name in names]
    if not files:
        raise InputError(f"{path}: has no files; record something")
    return files
