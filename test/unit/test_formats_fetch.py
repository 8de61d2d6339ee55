"""Downloads from a server on this machine, and what can go wrong with them."""

import dataclasses
import hashlib
import io
import threading
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from sugiyama_ros.errors import InputError, OutputError
from sugiyama_ros.formats import fetch
from sugiyama_ros.formats.registry import read_tracks

DATA = b"# circuit length is 100m.\n1.0 0.0\n2.0 0.5\n3.0 1.0\n\n50.0 0.0\n51.0 0.5\n52.0 1.0\n"


def zipped(**members: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name.replace("__", "/"), content)
    return out.getvalue()


@pytest.fixture
def server() -> Iterator[dict[str, bytes]]:
    """Files that a server offers, by path; the key "" holds the address of the server."""
    offered: dict[str, bytes] = {}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            content = offered.get(self.path)
            if content is None:
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content[: len(content) // 2] if self.path == "/cut" else content)

        def log_message(self, format: str, *args: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as httpd:
        thread = threading.Thread(target=httpd.serve_forever, daemon=True)
        thread.start()
        offered[""] = f"http://127.0.0.1:{httpd.server_port}".encode()
        yield offered
        httpd.shutdown()
        thread.join()


def offer(
    server: dict[str, bytes],
    monkeypatch: pytest.MonkeyPatch,
    content: bytes,
    path: str = "/data.zip",
    **changes: object,
) -> str:
    """Put a file onto the server and into the catalogue; returns its address."""
    server[path] = content
    entry = dataclasses.replace(
        fetch.CATALOGUE["sugiyama2008"],
        url=server[""].decode() + path,
        size_bytes=len(content),
        sha256=hashlib.sha256(content).hexdigest(),
    )
    monkeypatch.setitem(fetch.CATALOGUE, "sugiyama2008", dataclasses.replace(entry, **changes))
    return entry.url


def refused(directory: Path, url: str | None = None) -> str:
    with pytest.raises(InputError) as caught:
        fetch.fetch("sugiyama2008", directory, url)
    assert "\n" not in str(caught.value)
    assert list(directory.iterdir()) == []
    return str(caught.value)


def test_fetch(server: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = zipped(data__case1__data=b"", readme=b"x", folder__case1_data=b"y", **{"../../case1.data": DATA})
    offer(server, monkeypatch, content)
    told: list[tuple[int, int]] = []
    done = fetch.fetch("sugiyama2008", tmp_path / "new" / "folder", on_progress=lambda *bytes_: told.append(bytes_))
    # Whatever path the archive states, the file lies in the given directory.
    assert sorted(p.name for p in (tmp_path / "new" / "folder").iterdir()) == ["case1.data", "case1.mcap"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new"]
    assert done.data.read_bytes() == DATA
    assert told[-1] == (len(content), len(content))
    trajectories = read_tracks(done.bag).dense()
    assert trajectories.position_m.tolist() == [[1.0, 50.0], [2.0, 51.0], [3.0, 52.0]]
    assert trajectories.sha256 == hashlib.sha256(DATA).hexdigest()


def test_what_may_go_wrong(server: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = zipped(**{"case1.data": DATA})
    url = offer(server, monkeypatch, content)
    assert "the server answers 404" in refused(tmp_path, url + "x")
    assert "cannot be reached" in refused(tmp_path, "http://127.0.0.1:9/data.zip")
    assert "not a web address" in refused(tmp_path, "file:///etc/passwd")
    offer(server, monkeypatch, content, size_bytes=10)
    assert "larger than the 10 bytes expected" in refused(tmp_path)
    offer(server, monkeypatch, content, size_bytes=10_000)
    assert f"not the expected file: {len(content)} bytes" in refused(tmp_path)
    offer(server, monkeypatch, content, sha256="0" * 64)
    assert "expected" in (said := refused(tmp_path))
    assert "0" * 64 in said
    offer(server, monkeypatch, content, path="/cut")
    assert "the download broke off" in refused(tmp_path)
    offer(server, monkeypatch, zipped(**{"case2.data": DATA, "x.txt": b""}))
    assert "has not one case1.data but case2.data" in refused(tmp_path)
    offer(server, monkeypatch, b"no zip at all")
    assert "cannot be unpacked" in refused(tmp_path)
    offer(server, monkeypatch, zipped(**{"case1.data": bytes(20 << 20)}))
    assert "more than 16777216 bytes unpacked" in refused(tmp_path)
    flipped = bytearray(content)
    flipped[45] ^= 0xFF
    offer(server, monkeypatch, bytes(flipped))
    assert "cannot be unpacked" in refused(tmp_path)


def test_files_of_the_user_stay(server: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also after a download that fails: an archive of the same name, and what an earlier download has brought."""
    mine = tmp_path / "sugiyama2008.zip"
    mine.write_bytes(b"mine")
    offer(server, monkeypatch, b"no zip at all")
    with pytest.raises(InputError, match="cannot be unpacked"):
        fetch.fetch("sugiyama2008", tmp_path)
    offer(server, monkeypatch, zipped(**{"case1.data": DATA}))
    fetch.fetch("sugiyama2008", tmp_path)
    (tmp_path / "case1.data").write_bytes(b"edited")
    with pytest.raises(OutputError, match="exists already"):
        fetch.fetch("sugiyama2008", tmp_path)
    assert (mine.read_bytes(), (tmp_path / "case1.data").read_bytes()) == (b"mine", b"edited")
    assert fetch.fetch("sugiyama2008", tmp_path, overwrite=True).data.read_bytes() == DATA
    assert sorted(p.name for p in tmp_path.iterdir()) == ["case1.data", "case1.mcap", "sugiyama2008.zip"]


def test_an_unknown_name_and_a_bad_place(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not in the catalogue; it has sugiyama2008"):
        fetch.fetch("sugiyama", tmp_path)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="cannot be written"):
        fetch.fetch("sugiyama2008", tmp_path / "file")


def test_the_licence_is_stated() -> None:
    licence = fetch.CATALOGUE["sugiyama2008"].licence
    for term in ("research", "non-commercial", "New J. Phys. 10 (2008) 033001", ["11", "(2009)", "083025"][0]):
        assert term in licence
