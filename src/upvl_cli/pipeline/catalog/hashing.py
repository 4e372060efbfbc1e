"""Hashes of 64 bits for comparisons: of numbers and texts by arrays, and the first bits of digests."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pyarrow as pa

Hashes = npt.NDArray[np.uint64]
Bools = npt.NDArray[np.bool_]

NO_DIGEST = 0  # of what is not there
_OTHER_TEXT = 1  # of a text that is no digest: equal to that of no file
_DIGEST = re.compile(r"[0-9a-f]{64}")
_CHUNK = 65_536  # texts that are hashed at a time, so that their bytes stay within some megabytes


def mix(values: Hashes) -> Hashes:
    """Return a permutation of all 64-bit numbers in which each bit depends on each (the finaliser of SplitMix64)."""
    mixed = values + np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))


def combine(columns: Sequence[Hashes], rows: int) -> Hashes:
    """Return one (rows,) hash of several columns, each (rows,) or (1,), in their order."""
    combined = np.full(rows, len(columns), dtype=np.uint64)
    for column in columns:
        combined = mix(combined ^ column)
    return combined


def text_hashes(texts: pa.Array) -> Hashes:
    """Return the (n,) hashes of n texts; null counts as empty."""
    found = np.zeros(len(texts), dtype=np.uint64)
    for start in range(0, len(texts), _CHUNK):
        chunk = texts.slice(start, _CHUNK).cast(pa.large_binary()).fill_null(b"")
        found[start : start + _CHUNK] = _chunk_hashes(chunk)
    return found


def _chunk_hashes(texts: pa.Array) -> Hashes:
    offsets = np.frombuffer(texts.buffers()[1], dtype=np.int64)[texts.offset : texts.offset + len(texts) + 1]
    data = np.frombuffer(texts.buffers()[2] or b"", dtype=np.uint8)
    lengths = np.diff(offsets)
    found = np.zeros(len(texts), dtype=np.uint64)
    for length in np.unique(lengths).tolist():
        rows = np.flatnonzero(lengths == length)
        words = -(-length // 8)
        padded = np.zeros((len(rows), words * 8), dtype=np.uint8)
        padded[:, :length] = data[offsets[rows, None] + np.arange(length)]
        columns = padded.view("<u8").astype(np.uint64).T
        found[rows] = combine([np.array([length], dtype=np.uint64), *columns], len(rows))
    return found


def text_hash(text: str) -> int:
    """Return the hash of one long text, by SHA-256."""
    return int.from_bytes(hashlib.sha256(text.encode("utf-8", "surrogatepass")).digest()[:8], "little")


def digest_prefix(digest: str) -> int:
    """Return the first 64 bits of a SHA-256 in hexadecimal digits; `NO_DIGEST` for an empty text."""
    if not digest:
        return NO_DIGEST
    return int(digest[:16], 16) if _DIGEST.fullmatch(digest) else _OTHER_TEXT
