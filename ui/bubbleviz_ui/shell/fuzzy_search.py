"""Fuzzy search: letters in order, better close together and where words begin."""

from __future__ import annotations

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


def ranked(query: str, texts: list[str]) -> list[str]:
    """Texts that fit, the best first; equally good ones in the order given."""
    scores = {text: value for text in texts if (value := score(query, text)) is not None}
    return sorted(scores, key=lambda text: -scores[text])
