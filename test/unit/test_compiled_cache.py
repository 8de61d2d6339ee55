"""Compiled code is not used any more once a file that it was made of has changed."""

import importlib
import os
from pathlib import Path

import pytest

from sugiyama_ros import compiled_cache


@pytest.fixture
def package(tmp_path, monkeypatch):
    (tmp_path / "driver").mkdir()
    (tmp_path / "driver/utility.py").write_text("a = 1\n")
    monkeypatch.setattr(compiled_cache, "_PACKAGE", tmp_path)
    monkeypatch.setattr(compiled_cache, "sys", type("NoModules", (), {"modules": {}}))
    # set first, so that what the code sets is taken back at the end
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    return tmp_path


def chosen(monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    compiled_cache.choose()
    return os.environ["NUMBA_CACHE_DIR"]


def test_a_change_in_a_called_file_makes_a_new_folder_and_removes_the_old(package, monkeypatch):
    first = chosen(monkeypatch)
    Path(first).mkdir(parents=True)
    assert chosen(monkeypatch) == first
    assert Path(first).is_dir()
    (package / "driver/utility.py").write_text("a = 22\n")
    assert chosen(monkeypatch) != first
    assert not Path(first).exists()


def test_other_files_do_not_matter(package, monkeypatch):
    first = chosen(monkeypatch)
    (package / "cli.py").write_text("")
    assert chosen(monkeypatch) == first


def test_users_effects_matter(package, monkeypatch, tmp_path):
    first = chosen(monkeypatch)
    (tmp_path / "site/mine-1.0.dist-info").mkdir(parents=True)
    (tmp_path / "site/mine-1.0.dist-info/entry_points.txt").write_text("[sugiyama_ros.effects]\nsyrup = mine:EFFECT\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    without_file = chosen(monkeypatch)
    (tmp_path / "site/mine.py").write_text("a = 1\n")
    importlib.invalidate_caches()
    with_file = chosen(monkeypatch)
    (tmp_path / "site/mine.py").write_text("a = 22\n")
    assert len({first, without_file, with_file, chosen(monkeypatch)}) == 4


def test_the_users_folder_is_kept(package, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/somewhere")
    compiled_cache.choose()
    assert os.environ["NUMBA_CACHE_DIR"] == "/somewhere"
