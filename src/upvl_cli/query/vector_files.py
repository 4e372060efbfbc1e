"""The vectors of the boxes of a group of drives in a file of faiss, and the stamp that says what it was made of.

The file is an inverted index (IVF): the vectors are parted into lists of similar ones, and each is stored with eight
bits a component. A vector is a mean feature, or the mean of the looks at a track, of length 1 (`Basis.compact`): its
dot product with a word is their cosine. The centre of a list is the mean of its vectors, whose length says how
similar they are. The number of a vector is twice the row of its box among those of the group, and 1 more for looks.

A file is read only where its size and the digest of its head are those of the stamp. The head is all that the reader
of faiss interprets; the rest are codes and numbers of vectors, which are mapped, and whose damage costs hits alone.
"""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from upvl_cli.perception.visual.open_vocabulary import COMPONENTS
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.types import Array, Floats, Ints

if TYPE_CHECKING:
    import faiss

VERSION = 1  # of the files: another one for other vectors, numbers or lists
DIM = COMPONENTS + 1  # of `Basis.compact`
ENTRY_BYTES = DIM + 8  # a code and a number
_PART = 2**20  # bytes that are digested at once


@dataclass(frozen=True)
class Stamp:
    """What a file of vectors was made of.

    Attributes:
        version: `VERSION` of the code that made it.
        drives: Of each drive its name, the digests of its shard and of the basis, and how many boxes it has.
        vectors: How many vectors there are.
        size: Size of the file in bytes.
        head: Digest of what stands before the lists.
        content: Digest of the file.
    """

    version: int
    drives: tuple[tuple[str, str, int], ...]
    vectors: int
    size: int
    head: str
    content: str


def stamp_path(vectors: Path) -> Path:
    """Return the path of the stamp of a file of vectors."""
    return vectors.with_name(f"{vectors.stem}.json")


def read_stamp(vectors: Path) -> Stamp | None:
    """Return the stamp of a file of vectors; None where there is none of this version."""
    with suppress(OSError, ValueError, TypeError, KeyError, RecursionError):
        with stamp_path(vectors).open("rb") as file:
            values = json.load(file)
        drives = tuple((str(name), str(digest), int(boxes)) for name, digest, boxes in values["drives"])
        stamp = Stamp(**{**values, "drives": drives})
        numbers = (stamp.version, stamp.vectors, stamp.size, *(boxes for _, _, boxes in drives))
        if stamp.version == VERSION and all(type(number) is int and number >= 0 for number in numbers):
            return stamp
    return None


def is_whole(vectors: Path, stamp: Stamp) -> bool:
    """Return whether a file of vectors has the content that its stamp says; all of it is read."""
    with suppress(OSError):
        digest = hashlib.sha256()
        with vectors.open("rb") as file:
            while part := file.read(_PART):
                digest.update(part)
        return digest.hexdigest() == stamp.content
    return False


def write_vectors(path: Path, index: Any, drives: tuple[tuple[str, str, int], ...]) -> Stamp:
    """Write an index of faiss and then its stamp; return the stamp.

    Args:
        path: Where the file goes.
        index: The inverted index.
        drives: As in `Stamp`.
    """
    import faiss

    content: Any = memoryview(faiss.serialize_index(index))  # type: ignore[arg-type]
    head = len(content) - index.ntotal * ENTRY_BYTES
    stamp = Stamp(
        VERSION,
        drives,
        int(index.ntotal),
        len(content),
        hashlib.sha256(content[:head]).hexdigest(),
        hashlib.sha256(content).hexdigest(),
    )
    with atomic_file(path) as file:
        file.write(content)
    with atomic_file(stamp_path(path)) as file:
        file.write(json.dumps(asdict(stamp)).encode())
    return stamp


class VectorFile:
    """The lists of a file of vectors, mapped into memory.

    Attributes:
        stamp: What it was made of.
        first_row: (drives + 1,) first row of the boxes of each drive among those of the group.
        center: (lists, DIM) mean of the vectors of each list.
        size: (lists,) how many vectors each list has.
    """

    def __init__(self, stamp: Stamp, index: faiss.IndexIVFScalarQuantizer) -> None:
        """Take what is small out of an index."""
        import faiss

        self.stamp = stamp
        self.first_row = np.cumsum([0, *(boxes for _, _, boxes in stamp.drives)])
        lists: Any = index.invlists
        self._lists = lists
        self._index = index  # owns the lists
        flat = faiss.downcast_index(index.quantizer)
        self.center: Floats = np.asarray(flat.reconstruct_n(0, index.nlist), np.float32)
        self.size: Ints = np.array([lists.list_size(number) for number in range(index.nlist)])
        lowest, extent = faiss.vector_to_array(index.sq.trained).reshape(2, DIM)
        self._step = (extent / 255).astype(np.float32)
        self._offset = (lowest + extent / 510).astype(np.float32)

    @classmethod
    def open(cls, path: Path, stamp: Stamp) -> VectorFile | None:
        """Return an opened file; None where it is not the one of the stamp, or faiss is not installed."""
        try:
            import faiss
        except ImportError:
            return None
        with suppress(OSError, RuntimeError):
            local = os.fspath(path)
            head = stamp.size - stamp.vectors * ENTRY_BYTES
            with Path(local).open("rb") as file:
                same = os.fstat(file.fileno()).st_size == stamp.size and head > 0
                if not same or hashlib.sha256(file.read(head)).hexdigest() != stamp.head:
                    return None
            index: Any = faiss.read_index(local, faiss.IO_FLAG_MMAP | faiss.IO_FLAG_READ_ONLY)
            right = isinstance(index, faiss.IndexIVFScalarQuantizer) and index.d == DIM
            if right and index.code_size == DIM and index.ntotal == stamp.vectors:
                return cls(stamp, index)
        return None

    def words(self, compact: Floats) -> tuple[Floats, Floats]:
        """Return what turns codes into cosines with words: (t, DIM) factors of a code, and (t,) summands.

        Args:
            compact: (t, DIM) words of `Basis.compact_words`.
        """
        return compact * self._step, compact @ self._offset

    def read(self, lists: Ints) -> tuple[Array, Ints]:
        """Return (n, DIM) uint8 codes and (n,) numbers of the vectors of some lists, at least one vector."""
        import faiss

        codes, numbers = [], []
        for one in lists.tolist():
            if size := int(self.size[one]):
                codes.append(faiss.rev_swig_ptr(self._lists.get_codes(one), size * DIM).reshape(size, DIM))
                numbers.append(faiss.rev_swig_ptr(self._lists.get_ids(one), size))
        return np.concatenate(codes), np.concatenate(numbers)
