"""Executors: many items in turn."""

import math
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import pytest

from sugiyama_ros import workers
from sugiyama_ros.workers import ordered_map


def test_only_some_of_many_items_are_under_way(monkeypatch):
    monkeypatch.setattr(workers, "_TASKS", 8)
    made = []

    def items():
        for number in range(50):
            made.append(number)
            yield number

    with ThreadPoolExecutor(2) as work:
        for done, result in enumerate(ordered_map(math.sqrt, items(), work)):
            assert result == math.sqrt(done)
            assert len(made) <= done + 8
    assert len(made) == 50


@pytest.mark.parametrize("items", [0, 1500])
def test_results_come_in_the_order_of_the_items(items):
    expected = [math.sqrt(number) for number in range(items)]
    assert list(ordered_map(math.sqrt, range(items), None)) == expected
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as work:
        assert list(ordered_map(math.sqrt, range(items), work)) == expected


def test_a_process_gets_more_at_a_time_where_there_are_many_items(monkeypatch):
    monkeypatch.setattr(workers, "_TASKS", 8)
    sizes, made, submit = [], [], ProcessPoolExecutor.submit
    monkeypatch.setattr(
        ProcessPoolExecutor, "submit", lambda pool, f, *args: sizes.append(len(args[-1])) or submit(pool, f, *args)
    )

    def items():
        for number in range(2000):
            made.append(number)
            yield number

    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as work:
        for done, _ in enumerate(ordered_map(math.sqrt, items(), work)):
            # as many items as eight tasks of the smallest size, and what is made next
            assert len(made) <= done + 8 * 8 + 32
    assert (sizes[0], max(sizes)) == (8, 32)
    assert all(size <= max(8, sum(sizes[:k]) // 32) for k, size in enumerate(sizes))


def test_what_goes_wrong_in_a_task_is_told():
    with ThreadPoolExecutor(1) as work, pytest.raises(TypeError):
        list(ordered_map(math.sqrt, ["a", None], work))
