"""Roads in the forms of Lanelet2, CommonRoad and SUMO, as small files."""

import numpy as np


def osm(nodes: dict[int, tuple[float, float]], ways: dict[int, list[int]], *relations: str, local: bool = True) -> str:
    """A map of Lanelet2; places are local [m], or latitudes and longitudes [degrees]."""
    text = []
    for name, (first, second) in nodes.items():
        tags = f'<tag k="local_x" v="{first}"/><tag k="local_y" v="{second}"/>' if local else ""
        degrees = (0.0, 0.0) if local else (first, second)
        text.append(f'<node id="{name}" lat="{degrees[0]}" lon="{degrees[1]}">{tags}</node>')
    for name, refs in ways.items():
        text.append(f'<way id="{name}">{"".join(f"""<nd ref="{ref}"/>""" for ref in refs)}</way>')
    return f'<?xml version="1.0"?><osm>{"".join(text)}{"".join(relations)}</osm>'


def relation(name: int, members: list[tuple[str, int]], **tags: str) -> str:
    inside = "".join(f'<member type="x" ref="{ref}" role="{role}"/>' for role, ref in members)
    return f'<relation id="{name}">{inside}{"".join(f"""<tag k="{k}" v="{v}"/>""" for k, v in tags.items())}</relation>'


def lanelet(name: int, left: int, right: int, *more: tuple[str, int], **tags: str) -> str:
    return relation(name, [("left", left), ("right", right), *more], type="lanelet", **{"subtype": "road", **tags})


def crossing_osm() -> str:
    """A road to the east, a lane beside its second half, and a road to the north that yields and has a light."""
    nodes = {1: (0, 2), 2: (30, 2), 3: (60, 2), 4: (0, -2), 5: (30, -2), 6: (60, -2), 7: (30, 6), 8: (60, 6)}
    nodes |= {11: (38, -30), 12: (38, 30), 13: (42, -30), 14: (42, 30), 21: (38, -5), 22: (42, -5)}
    # the right bound of the first lanelet, and both of the crossing road, run against the direction of driving
    ways = {1: [1, 2], 2: [5, 4], 3: [2, 3], 4: [5, 6], 5: [7, 8], 11: [12, 11], 12: [14, 13], 20: [21, 22]}
    return osm(
        nodes,
        ways,
        lanelet(100, 1, 2, speed_limit="36"),
        lanelet(101, 3, 4),
        lanelet(102, 5, 3),
        lanelet(103, 11, 12, ("regulatory_element", 200), ("regulatory_element", 201)),
        lanelet(104, 1, 2, subtype="crosswalk"),
        relation(
            200,
            [("right_of_way", 101), ("yield", 103), ("ref_line", 20)],
            type="regulatory_element",
            subtype="right_of_way",
        ),
        relation(201, [("refers", 9)], type="regulatory_element", subtype="traffic_light"),
    )


def bounds(*middle: tuple[float, float]) -> str:
    x, y = np.array(middle, dtype=float).T
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    sides = ((1.5, "left"), (-1.5, "right"))
    return "".join(
        f"<{name}Bound>"
        + "".join(
            f"<point><x>{px}</x><y>{py}</y></point>"
            for px, py in zip(x - d * np.sin(heading), y + d * np.cos(heading), strict=True)
        )
        + f"</{name}Bound>"
        for d, name in sides
    )


def scenario(sign: str, light: str) -> str:
    """A crossing of a road to the east and one to the north, straight ahead or to the left; signs are of the south."""
    turn = [(45.0 + 8.0 * (np.cos(a) - 1.0) + 5.0, -5.0 + 8.0 * np.sin(a)) for a in np.linspace(0.0, 0.5 * np.pi, 9)]
    lanelets = (
        ("1", [(0, 0), (45, 0)], '<successor ref="2"/>'),
        ("2", [(45, 0), (55, 0)], '<successor ref="3"/>'),
        ("3", [(55, 0), (90, 0)], ""),
        ("4", [(50, -50), (50, -5)], f'<successor ref="5"/><successor ref="7"/><stopLine/>{sign}{light}'),
        ("5", [(50, -5), (50, 5)], '<successor ref="6"/>'),
        ("6", [(50, 5), (50, 50)], ""),
        ("7", turn, ""),
        ("8", [(46.8, 50), (46.8, 5)], '<successor ref="9"/>'),
        ("9", [(46.8, 5), (46.8, -5)], ""),
    )
    text = "".join(f'<lanelet id="{name}">{bounds(*points)}{more}</lanelet>' for name, points, more in lanelets)
    return (
        f'<?xml version="1.0"?><commonRoad timeStepSize="0.1">{text}'
        '<trafficSign id="20"><trafficSignElement><trafficSignID>205</trafficSignID></trafficSignElement></trafficSign>'
        '<trafficSign id="21"><trafficSignElement><trafficSignID>274</trafficSignID>'
        "<additionalValue>8.5</additionalValue></trafficSignElement></trafficSign>"
        '<trafficLight id="30"><cycle><cycleElement><duration>300</duration><color>red</color></cycleElement>'
        "<cycleElement><duration>200</duration><color>green</color></cycleElement><timeOffset>100</timeOffset></cycle>"
        "<direction>left</direction></trafficLight>"
        '<intersection id="40"><incoming id="41"><incomingLanelet ref="1"/><successorsStraight ref="2"/></incoming>'
        '<incoming id="42"><incomingLanelet ref="4"/><successorsStraight ref="5"/><successorsLeft ref="7"/></incoming>'
        '<incoming id="43"><incomingLanelet ref="8"/><successorsStraight ref="9"/></incoming></intersection>'
        "</commonRoad>"
    )


def sumo_net(light: str = "", kind: str = "static") -> str:
    """Two roads of two lanes and one lane that cross; the one to the north yields. ``light``: states of a light."""
    shapes = {
        "east_0": "-50,0 -5,0", "east_1": "-50,3.2 -5,3.2", ":c_0_0": "-5,0 5,0", "out_0": "5,0 50,0",
        "north_0": "0,-50 0,-5", ":c_1_0": "0,-5 0,5", "up_0": "0,5 0,50", "walk_0": "-5,-5 5,-5",
    }  # fmt: skip
    edges: dict[str, list[str]] = {}
    for name, shape in shapes.items():
        forbidden = 'allow="pedestrian"' if name == "walk_0" else ""
        lane = f'<lane id="{name}" index="{name[-1]}" speed="13.9" length="45" shape="{shape}" {forbidden}/>'
        edges.setdefault(name[:-2], []).append(lane)
    links = "".join(
        f'<connection from="{a}" to="{b}" fromLane="0" toLane="0" via="{via}" {said} dir="s" state="m"/>'
        for a, b, via, said in (
            ("east", "out", ":c_0_0", 'tl="c" linkIndex="0"' * bool(light)),
            ("north", "up", ":c_1_0", 'tl="c" linkIndex="1"' * bool(light)),
        )
    )
    inside = "".join(
        f'<connection from="{a}" to="{b}" fromLane="0" toLane="0"/>' for a, b in ((":c_0", "out"), (":c_1", "up"))
    )
    phases = "".join(f'<phase duration="{20 + 10 * k}" state="{state}"/>' for k, state in enumerate(light.split()))
    program = f'<tlLogic id="c" type="{kind}" programID="0" offset="5">{phases}</tlLogic>' * bool(light)
    return (
        "<net>"
        + "".join(f'<edge id="{name}" from="a" to="b">{"".join(lanes)}</edge>' for name, lanes in edges.items())
        + program
        + '<junction id="c" type="priority" incLanes="east_0 east_1 north_0" intLanes=":c_0_0 :c_1_0">'
        '<request index="0" response="00" foes="10" cont="0"/><request index="1" response="01" foes="01" cont="0"/>'
        "</junction>" + links + inside + "</net>"
    )
