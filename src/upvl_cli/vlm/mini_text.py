"""The text encoder of `mini`: any English phrase as a vector, from tables made of all-MiniLM-L6-v2.

A phrase of the table has the full model's vector. Any other is the weighted mean of its tokens, as in
model2vec: rare tokens count more (smooth inverse frequency; Arora et al., "A simple but tough-to-beat
baseline for sentence embeddings", ICLR 2017), the frequency taken from the rank in the vocabulary (Zipf).

Pixels were trained on the synonyms of some concepts. A word that is near such a concept, the mean of its synonyms, is
attracted towards the direction that pictures gave to it, so that "motorway" finds what "road" finds and "fire truck"
not what "truck" finds, however near both words are in text; a word that is near none stays where it is.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from tokenizers import Tokenizer

from upvl_cli.types import Array, Floats, Ints
from upvl_cli.vlm.spelling import unknown_words

SMOOTH = 1e-3  # of the inverse frequency
# How words are attracted by concepts; docs/log.md has what was tried.
ATTRACTION = 3.0  # weight of the concepts, beside 1 of the word's own vector
TEMPERATURE = 0.03  # of the softmax over cosines with concepts
MIDPOINT, SLOPE = 0.35, 0.05  # logistic gate: cosine with the nearest concept at half weight, and its width


def normalize(phrase: str) -> str:
    """Return a phrase as the table has it: lower case, single spaces, no article, no full stop."""
    words = re.sub(r"\s+", " ", phrase.strip().lower()).rstrip(".")
    return re.sub(r"^(an?|the) (?=\S)", "", words)


class MiniText:
    """Vectors of phrases.

    Attributes:
        phrases: Those that have a vector of the full model.
        vectors: (p, d) theirs, of length 1.
    """

    def __init__(self, tables: Mapping[str, Array], phrases: Sequence[str], tokenizer: Path) -> None:
        """Take the tables.

        Args:
            tables: `tokens` (v, d), `phrases` (p, d), `concepts` (k, d) and `directions` (k, d), int8, each with its
                scale a row: `token_scale` (v,), `phrase_scale` (p,), `concept_scale` (k,), `direction_scale` (k,).
            phrases: The p phrases, as `normalize` writes them.
            tokenizer: JSON file of the tokenizer.
        """
        self._tokens = tables["tokens"] * tables["token_scale"][:, None]
        self.vectors = unit(tables["phrases"] * tables["phrase_scale"][:, None])
        self.concepts = unit(tables["concepts"] * tables["concept_scale"][:, None])
        self._directions = unit(tables["directions"] * tables["direction_scale"][:, None])
        self.phrases = tuple(phrases)
        self._place = {phrase: place for place, phrase in enumerate(self.phrases)}
        self._tokenizer = Tokenizer.from_file(str(tokenizer))
        self._tokenizer.no_padding()
        self._tokenizer.no_truncation()

    def embed(self, words: Sequence[str]) -> Floats:
        """Return (t, d) float32 vectors of length 1, attracted by concepts; zeros without a known token."""
        plain, share, near = self.before_attraction(words)
        return unit(plain + ATTRACTION * near[:, None] * unit(share @ self._directions))

    def before_attraction(self, words: Sequence[str]) -> tuple[Floats, Floats, Floats]:
        """Return what the attraction of t phrases by k concepts is computed from.

        Returns:
            (t, d) vectors as `embed_plain` gives them; (t, k) shares of the concepts, summing to 1; (t,) how near
            the nearest concept is, 0 to 1, and 0 for a phrase without a known token.
        """
        plain = self.embed_plain(words)
        similarity = plain @ self.concepts.T
        largest = similarity.max(axis=1, initial=-1)
        share = np.exp((similarity - largest[:, None]) / TEMPERATURE)
        near = plain.any(axis=1) / (1 + np.exp((MIDPOINT - largest) / SLOPE))
        share /= share.sum(axis=1, keepdims=True)
        return plain, share.astype(np.float32), near.astype(np.float32)

    def embed_plain(self, words: Sequence[str]) -> Floats:
        """Return (t, d) float32 vectors of length 1 of the full model or of the tokens, without attraction."""
        rows = [self._vector(normalize(word)) for word in words]
        return np.array(rows, dtype=np.float32).reshape(-1, self._tokens.shape[1])

    def concept_cosines(self, phrases: Sequence[str]) -> Floats:
        """Return (t, k) cosines of phrases, not attracted, with the concepts."""
        return np.asarray(self.embed_plain(phrases) @ self.concepts.T)

    def _vector(self, phrase: str) -> Floats:
        place = self._place.get(phrase)
        return self.vectors[place] if place is not None else self.embed_tokens(phrase)

    def unknown_words(self, phrases: Sequence[str]) -> list[tuple[str, str]]:
        """Return words that are neither complete tokens nor in a phrase of the table, with a likely spelling."""
        return unknown_words(
            [word for phrase in phrases for word in self._words(phrase)],
            lambda word: self._tokenizer.token_to_id(word) is not None,
            {word for phrase in self.phrases for word in self._words(phrase)},
        )

    def _words(self, phrase: str) -> list[str]:
        normal = self._tokenizer.normalizer.normalize_str(normalize(phrase))
        return [word for word, _ in self._tokenizer.pre_tokenizer.pre_tokenize_str(normal)]

    def embed_tokens(self, phrase: str) -> Floats:
        """Return the (d,) vector of a phrase outside the table."""
        token = np.array(self._tokenizer.encode(phrase, add_special_tokens=False).ids, dtype=np.int64)
        return unit((self._tokens[token] * token_weight(token, len(self._tokens))[:, None]).sum(axis=0))


def token_weight(token: Ints, total: int) -> Floats:
    """Return the (n,) weight of each token: the smooth inverse of how frequent Zipf's law says it is."""
    frequency = 1 / ((token + 2) * np.log(total))
    return np.asarray(SMOOTH / (SMOOTH + frequency))


def unit(vectors: Array) -> Floats:
    """Return vectors scaled to length 1; a zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1), dtype=np.float32)
