"""A cache that forgets what was used longest ago."""

from __future__ import annotations

from upvl_cli.runtime.bounded_cache import BoundedCache


def test_what_was_used_longest_ago_is_forgotten() -> None:
    cache: BoundedCache[str] = BoundedCache(2)
    cache.put("a", "1")
    cache.put("b", "2")
    assert cache.get("a") == "1"
    cache.put("c", "3")
    assert [cache.get(key) for key in "abc"] == ["1", None, "3"]


def test_sizes_are_counted() -> None:
    cache: BoundedCache[bytes] = BoundedCache(10, len)
    cache.put("a", b"12345")
    cache.put("a", b"123")
    cache.put("b", b"1234567")
    assert cache.get("a") == b"123"
    cache.put("c", b"12345678901")  # too large to be kept at all
    assert cache.get("c") is None
    assert cache.get("b") == b"1234567"
    cache.put("d", b"1")
    assert cache.get("a") is None


def test_a_value_is_made_once() -> None:
    cache: BoundedCache[list[int]] = BoundedCache(2)
    first = cache.get_or_make("a", list)
    assert cache.get_or_make("a", list) is first
