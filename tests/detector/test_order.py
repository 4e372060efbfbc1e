"""The order of training frames: each once an epoch, from the seed alone, few drives at a time, without lists."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from upvl_cli.detector.config import ShuffleConfig
from upvl_cli.detector.data.numbers import FrameNumbers
from upvl_cli.detector.data.permutation import permuted
from upvl_cli.detector.data.sampler import FrameOrder

KEYS = st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=8)
SEED = st.integers(0, 2**31 - 1)


def order(frames: int, seed: int = 0, chunk: int = 3, window: int = 4) -> FrameOrder:
    return FrameOrder(frames, seed, ShuffleConfig(chunk_frames=chunk, window_chunks=window))


def epoch(of: FrameOrder, number: int) -> list[int]:
    return [of.frame_at(index) for index in range(number * of.frames, (number + 1) * of.frames)]


@given(st.integers(1, 700), KEYS)
def test_a_permutation_takes_each_number_once(size: int, keys: list[int]) -> None:
    assert sorted(permuted(index, size, keys) for index in range(size)) == list(range(size))


def test_a_permutation_depends_on_each_key_and_mixes_large_ranges() -> None:
    size = 10**9 + 7
    found = np.array([permuted(index, size, (1, 2, 3, 4)) for index in range(2000)])
    other = np.array([permuted(index, size, (1, 2, 3, 5)) for index in range(2000)])
    assert len(np.unique(found)) == 2000 and (found != other).mean() > 0.99
    # Neighbours are as far from each other as chance has it: a third of the range on average.
    assert abs(np.abs(np.diff(found)).mean() / size - 1 / 3) < 0.02
    assert abs(found.mean() / size - 1 / 2) < 0.02


@given(st.integers(1, 400), SEED, st.integers(1, 40), st.integers(1, 12), st.integers(0, 3))
def test_each_frame_comes_once_an_epoch(frames: int, seed: int, chunk: int, window: int, number: int) -> None:
    assert sorted(epoch(order(frames, seed, chunk, window), number)) == list(range(frames))


def test_the_order_follows_from_seed_and_epoch() -> None:
    assert epoch(order(50), 1) == epoch(order(50), 1)
    assert epoch(order(50), 0) != epoch(order(50), 1)
    assert epoch(order(50, seed=1), 0) != epoch(order(50, seed=2), 0)


def test_few_frames_are_shuffled_as_a_whole() -> None:
    expected = np.random.default_rng([7, 0, 2]).permutation(23)  # the order that earlier versions had
    np.testing.assert_array_equal(epoch(order(23, seed=7), 2), expected)


def test_a_window_reads_few_chunks_and_mixes_their_frames() -> None:
    of = order(10_000, chunk=10, window=20)
    first = np.array(epoch(of, 0)[:200])
    assert len(np.unique(first // 10)) == 20
    assert np.ptp(first // 10) > 500  # chunks from anywhere
    assert (np.diff(first) == 1).mean() < 0.05  # in no order
    second = np.array(epoch(of, 1)[:200])
    assert len(np.intersect1d(first // 10, second // 10)) < 5  # another window each epoch


def test_no_window_is_much_smaller_than_the_settings_say() -> None:
    of = order(99, chunk=3, window=4)  # 33 chunks: eight windows of four, and one chunk more
    found = [of._window(chunk, 33) for chunk in range(33)]
    assert [first for _, first, _ in found] == sorted(first for _, first, _ in found)
    assert {end - first for _, first, end in found} == {4, 5}
    assert all(first <= chunk < end for chunk, (_, first, end) in enumerate(found))


def test_an_archive_of_any_size_needs_no_memory() -> None:
    of = order(10**15, chunk=128, window=64)
    found = [of.frame_at(index) for index in (0, 10**14, 10**15 - 1, 10**16)]
    assert all(0 <= frame < 10**15 for frame in found) and len(set(found)) == 4


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(1, 3)), min_size=1, max_size=8),
    st.sampled_from([0.0, 0.1, 0.3, 0.5, 0.9]),
)
def test_numbers_are_those_of_a_list_of_all_frames(drives: list[tuple[int, int]], share: float) -> None:
    lengths, repeats = np.array(drives).T
    numbers = FrameNumbers.of_lengths(lengths, repeats, share, 10**6)
    end = [length - round(share * length) for length, _ in drives]
    train = [(d, i) for d, (_, times) in enumerate(drives) for i in range(end[d]) for _ in range(times)]
    held_out = [(d, i) for d, (length, _) in enumerate(drives) for i in range(end[d], length)]
    assert (numbers.train, numbers.checked) == (len(train), len(held_out))
    assert [numbers.frame_of(number) for number in range(len(train) + len(held_out))] == train + held_out


def test_a_check_has_some_of_many_held_out_frames_from_all_drives() -> None:
    numbers = FrameNumbers.of_lengths(np.full(1000, 20), np.ones(1000, int), 0.5, 100)
    assert (numbers.train, numbers.checked) == (10_000, 100)
    found = [numbers.frame_of(10_000 + k) for k in range(100)]
    assert [drive for drive, _ in found] == list(range(0, 1000, 10))
    assert all(index >= 10 for _, index in found)
