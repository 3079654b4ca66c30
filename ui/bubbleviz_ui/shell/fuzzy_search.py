"""Fuzzy search: letters in order, better close together and where words begin."""

from __future__ import annotations

import re

STEP = " › "
"""Between the names of menus and of what is in them."""
AT_WORD, NEXT_TO, GAP = 3.0, 2.0, 0.05  # scores of a letter; chosen


def score(query: str, text: str) -> float | None:
    """How well a text fits what was typed; None when its letters are not there in this order."""
    wanted, there = query.lower().replace(" ", ""), text.lower()
    best: list[float | None] = [None] * len(there)  # of matches that end at each letter
    if not wanted:
        return 0.0
    for k, letter in enumerate(wanted):
        now: list[float | None] = [None] * len(there)
        before: float | None = 0.0 if k == 0 else None  # best that ended further left, with gaps
        for i, other in enumerate(there):
            if other == letter:
                candidates = [] if before is None else [before]
                if k and i and (last := best[i - 1]) is not None:
                    candidates.append(last + NEXT_TO)
                if candidates:
                    starts = i == 0 or not there[i - 1].isalnum()
                    now[i] = max(candidates) + 1.0 + AT_WORD * starts
            if k and (ended := best[i]) is not None:
                before = ended if before is None else max(before - GAP, ended)
            elif before is not None and k:
                before -= GAP
        best = now
    found = [value for value in best if value is not None]
    return max(found) - GAP * len(there) if found else None


def ranked(query: str, paths: list[str]) -> list[str]:
    """Paths of items that fit, the best first; equally good ones in the order given.

    Words of an item's own name come before those of its path, and words before scattered letters.
    """
    ranks = {path: rank for path in paths if (rank := _rank(query, path)) is not None}
    return sorted(ranks, key=lambda path: ranks[path])


def _rank(query: str, path: str) -> tuple[int, float] | None:
    """Kind of the match and how poor it is among its kind; None for no match."""
    name = path.split(STEP)[-1]
    of_name, of_path = score(query, name), score(query, path)
    typed = query.lower().split()
    if of_path is None:
        return None
    if of_name is not None and set(typed) <= set(_words(name)):
        return 0, -of_name
    if of_name is not None and _begin(typed, name):
        return 1, -of_name
    if _begin(typed, path):
        return 2, -of_path
    return (4, -of_path) if of_name is None else (3, -of_name)


def _begin(typed: list[str], text: str) -> bool:
    """Whether each word that was typed begins a word of the text."""
    return all(any(word.startswith(part) for word in _words(text)) for part in typed)


def _words(text: str) -> list[str]:
    return re.findall(r"\w+", text.lower())
