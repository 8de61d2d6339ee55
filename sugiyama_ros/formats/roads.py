"""Roads as graphs out of files of any known form."""

from pathlib import Path

from sugiyama_ros.arguments import checked
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.commonroad_road import read_commonroad_road
from sugiyama_ros.formats.lanelet2 import read_lanelet2
from sugiyama_ros.formats.reading import GZIP, has_root, root_of
from sugiyama_ros.formats.road_csv import read_road_csv
from sugiyama_ros.formats.sheet import head_of
from sugiyama_ros.formats.sumo_net import read_sumo_net
from sugiyama_ros.roads.network import Network


@checked()
def read_road(path: str | Path) -> Network:
    """Read a road as a graph: lanes, places where they meet, and signals.

    Parameters
    ----------
    path : str or Path
        A map of Lanelet2 (``.osm``), a CommonRoad scenario (``.xml``) or a network of SUMO (``.net.xml``), each also
        packed by gzip, or CSV with a row for each point of the middle of a lane.

    Returns
    -------
    Network
        The road; its notes say what was left out, as lanes that are not for cars or that cannot be read.

    Raises
    ------
    InputError
        With the line or the part of the file, if no road can be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> import sugiyama_ros as sg
    >>> rows = ["lane,x_m,y_m,successors", "a,0,0,b", "a,50,0,", "b,50,0,", "b,80,10,"]
    >>> _ = Path("road.csv").write_text("\\n".join(rows))
    >>> sg.read_road("road.csv").headline()
    'road of 2 lanes, 82 m in all; 0 conflicts, in 0 of which drivers yield by rule; 0 signals'
    """
    path = Path(path)
    head = head_of(path)
    if has_root(head, path, "osm"):
        return read_lanelet2(path)
    if has_root(head, path, "commonRoad"):
        return read_commonroad_road(path)
    if has_root(head, path, "net"):
        return read_sumo_net(path)
    if not head:
        raise InputError(f"{path}: empty file; give a road of Lanelet2, CommonRoad or SUMO, or CSV")
    if head.lstrip().startswith((b"<", GZIP)):
        # says what is damaged
        root_of(path)
        raise InputError(f"{path}: not a road of Lanelet2, CommonRoad or SUMO; give one of these, or CSV")
    return read_road_csv(path)
