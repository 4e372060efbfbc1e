"""Results come in order whatever the threads do, a few items ahead and no more."""

from __future__ import annotations

import time

import pytest

from upvl_cli.runtime.parallel import THREADS_VARIABLE, in_order, threads


def test_results_come_in_the_order_of_the_items() -> None:
    def slow_first(item: int) -> int:
        time.sleep(0.02 if item == 0 else 0)
        return item * item

    assert list(in_order(slow_first, range(20))) == [item * item for item in range(20)]


def test_nothing_gives_nothing() -> None:
    assert list(in_order(str, [])) == []


def test_items_are_taken_only_a_few_ahead() -> None:
    taken: list[int] = []

    def items():  # noqa: ANN202
        for item in range(100):
            taken.append(item)
            yield item

    results = in_order(str, items())
    next(results)
    assert len(taken) <= threads() + 1


def test_a_failure_comes_out_and_ends_it() -> None:
    def fails(item: int) -> int:
        if item == 3:
            raise ValueError("three")
        return item

    with pytest.raises(ValueError, match="three"):
        list(in_order(fails, range(1000)))


def test_the_number_of_threads_can_be_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS_VARIABLE, "3")
    assert threads() == 3
