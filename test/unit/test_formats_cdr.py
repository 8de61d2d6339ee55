"""Messages to and from bytes without ROS; definitions in files are not trusted."""

import builtins
from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.cdr import Encoder, decoder, plain
from sugiyama_ros.formats.definitions import full_text, type_hash

SEPARATOR = "\n" + "=" * 80 + "\n"
MEASURED = "sugiyama_msgs/msg/MeasuredPositions"


def test_definitions_come_with_all_that_they_depend_on() -> None:
    text = full_text("visualization_msgs/msg/MarkerArray")
    named = [part.splitlines()[0] for part in text.split(SEPARATOR)[1:]]
    assert named[0] == "MSG: visualization_msgs/Marker"
    assert len(set(named)) == len(named)
    assert {"MSG: builtin_interfaces/Duration", "MSG: geometry_msgs/Quaternion", "MSG: std_msgs/ColorRGBA"} < set(named)
    assert "# " in text
    assert type_hash("std_msgs/msg/Header").startswith("RIHS01_")


@pytest.mark.parametrize(
    "name", ["no_such_msgs/msg/A", "std_msgs/Header", "../msg/Header", "std_msgs/msg/../Header", ""]
)
def test_definitions_that_are_not_there(name: str) -> None:
    with pytest.raises(InputError, match=r"not installed|not the name"):
        full_text(name)


def test_definitions_in_a_native_ros(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "share" / "odd_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Odd.msg").write_text("Even[<=3] even\nstring<=5 name\nint32 CONSTANT=5\n")
    (folder / "Even.msg").write_text("std_msgs/Header header\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    named = [part.splitlines()[0] for part in full_text("odd_msgs/msg/Odd").split(SEPARATOR)[1:]]
    assert named == ["MSG: odd_msgs/Even", "MSG: std_msgs/Header", "MSG: builtin_interfaces/Time"]
    assert type_hash("odd_msgs/msg/Odd") == ""


def test_a_message_there_and_back() -> None:
    data = Encoder(MEASURED)(
        MEASURED,
        header={"stamp": {"sec": -1, "nanosec": 5}, "frame_id": "r\u00f6ad"},
        step=9,
        vehicle=np.array([1, 2], dtype=np.int32),
        leader=np.array([2, -1], dtype=np.int32),
        position_m=np.array([0.5, np.nan]),
        length_m=np.array([4.0, 5.0]),
        lane=np.array([1, -1], dtype=np.int32),
        d_m=np.array([0.25, -3.5]),
        clear_s=np.array([np.inf, -2.0]),
    )
    decode = decoder(MEASURED, full_text(MEASURED))
    assert decode is not None
    message = plain(decode(data))
    assert message.pop("position_m")[0] == 0.5
    assert message == {
        "header": {"stamp": {"sec": -1, "nanosec": 5}, "frame_id": "r\u00f6ad"},
        "step": 9,
        "vehicle": [1, 2],
        "leader": [2, -1],
        "length_m": [4.0, 5.0],
        "lane": [1, -1],
        "d_m": [0.25, -3.5],
        "clear_s": [np.inf, -2.0],
        # lists that were left out
        "stamp_offset_s": [],
        "position_var": [],
        "line_m": [],
        "arrive_s": [],
        "curvature_per_m": [],
        "leader_shift_m": [],
    }
    for broken in (data[:-1], data[:30], b"", b"\0\3\0\0" + data[4:]):
        with pytest.raises(ValueError, match=r".") as caught:
            decode(broken)
        assert "\n" not in str(caught.value)


def chain(names: str, fields: int) -> str:
    """A chain of types: each type holds several values of the next type."""
    first, *rest = ["".join(f"{below} f{k}\n" for k in range(fields)) for below in [*names[1:], "int32"]]
    return first + "".join(f"{SEPARATOR[1:]}MSG: a/{name}\n{text}" for name, text in zip(names[1:], rest, strict=True))


@pytest.mark.parametrize(
    "text",
    [
        "A a\n",  # holds itself
        f"B b{SEPARATOR}MSG: a/B\nA a\n",
        "B b\n",  # is not there
        "wstring s\n",
        "string[1000000000] s\n",  # would be unrolled
        "uint8[-5] x\n",
        "uint8[0] x\n",  # takes no bytes
        "int32 x\nint32 x\n",
        "int32 x\n" * 10_000,
        "int32 x)\n",
        'string A="""\nint32 __class__\n',
        f"int32 x{SEPARATOR}MSG: a/B(object)\nint32 x\n",
        chain("ABCDEFGHIJ", 1),  # too deep
        "\x00",
        "int32\n",
    ],
)
def test_hostile_definitions_are_not_used(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert decoder("a/msg/A", text) is None


@pytest.mark.parametrize("name", ["a/msg/A(x)", "a\nint32 y", "../msg/A", "", "a", "a/msg/A:", "a/msg/A\n\nimport os"])
def test_hostile_names_are_not_used(name: str) -> None:
    decode = decoder(name, "int32 x\n")
    if decode is not None:
        assert plain(decode(b"\0\1\0\0\5\0\0\0")) == {"x": 5}


def test_texts_in_definitions_are_never_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(builtins, "run_by_definition", run, raising=False)
    for text in (
        "string A='\\'+run_by_definition()+\\''\nint32 x\n",
        'string A="""+run_by_definition()+"""\nint32 x\n',
        "string A=')\\n    run_by_definition()\\n('\nint32 x\n",
        "string A={run_by_definition()}\nint32 x\n",
        "int32 x run_by_definition()\n",
        "int32 x = run_by_definition()\n",
        f"int32 x{SEPARATOR}MSG: a/1B\nint32 x\n{SEPARATOR}MSG: a/B\nclass x\n",
    ):
        decode = decoder("a/msg/A", text)
        if decode is not None:
            assert decode(b"\0\1\0\0\5\0\0\0").x == 5


def test_many_types_are_bounded_quickly() -> None:
    # 30 fields of the next type at each of 6 levels: a count without memory would take 30^6 steps.
    decode = decoder("a/msg/A", chain("ABCDEF", 30))
    assert decode is not None
    with pytest.raises(ValueError, match="unpack_from requires"):
        decode(b"\0\1\0\0" + bytes(100))


def test_large_lists_of_messages_are_not_decoded() -> None:
    decode = decoder("a/msg/A", f"B[] b{SEPARATOR}MSG: a/B\nuint8 x\n")
    assert decode is not None
    assert len(decode(b"\0\1\0\0\3\0\0\0abc").b) == 3
    with pytest.raises(ValueError, match="more than the limit of 262144"):
        decode(b"\0\1\0\0" + bytes(1 << 20))
