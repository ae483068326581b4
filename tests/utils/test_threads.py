"""Blocks on one thread: nested, concurrent, after exceptions; nothing leaks to the caller."""

from __future__ import annotations

from threading import Barrier, Thread

import pytest
import torch

from sfmkit._utils.threads import one_thread


@pytest.fixture(params=[1, 2, 3])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def default_of_a_new_thread() -> int:
    found: list[int] = []
    thread = Thread(target=lambda: found.append(torch.get_num_threads()))
    thread.start()
    thread.join()
    return found[0]


def test_the_count_is_one_inside_and_restored_outside(threads):
    with one_thread():
        assert torch.get_num_threads() == 1
        with one_thread():
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == threads
    assert default_of_a_new_thread() == threads


def test_an_exception_restores_the_count(threads):
    @one_thread()
    def fail():
        assert torch.get_num_threads() == 1
        raise ValueError

    with pytest.raises(ValueError):
        fail()
    assert torch.get_num_threads() == threads
    assert default_of_a_new_thread() == threads


def test_overlapping_blocks_of_several_threads_restore_the_count(threads):
    """The first to enter leaves first, so that the others restore after it."""
    inside, left = Barrier(4), []

    def work(k: int) -> None:
        with one_thread():
            inside.wait(timeout=30)
            assert torch.get_num_threads() == 1
        left.append(torch.get_num_threads())

    workers = [Thread(target=work, args=(k,)) for k in range(3)]
    with one_thread():
        for worker in workers:  # they use torch for the first time while the count is one
            worker.start()
        inside.wait(timeout=30)
    for worker in workers:
        worker.join()
    assert left == [threads] * 3
    assert torch.get_num_threads() == threads
    assert default_of_a_new_thread() == threads
