"""Frame ranges against Python's own slices."""

from itertools import product

import pytest
from hypothesis import given, strategies as st

from bubbleviz.api.frames import parse_frames
from bubbleviz.errors import InputError

bound = st.none() | st.integers(0, 40)


@given(bound, bound, st.none() | st.integers(0, 9), st.integers(1, 30), st.booleans())
def test_range_like_a_slice_or_one_sentence_of_error(start, stop, step, count, spaced):
    space = " " if spaced else ""
    parts = ["" if part is None else str(part) for part in (start, stop)]
    parts += [] if step is None else [str(step)]
    text = f"{space}:{space}".join(parts)
    try:
        chosen = parse_frames(text, count, "rec")
    except InputError as error:
        beyond = (start or 0) >= count or (stop or 0) > count
        empty = stop is not None and (start or 0) >= stop
        assert beyond or empty or step == 0
        assert "--frames" in str(error)
        assert "\n" not in str(error)
    else:
        assert list(chosen) == list(range(count))[slice(start, stop, step)] != []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        *((text, "A:B") for text in ("1", "a:b", "0:1:1:1", "", "-1:2")),
        *((text, "no frame") for text in ("2:1", "2:2")),
        ("0:3:0", "step"),
        *((text, "outside its 3 frames") for text in ("0:4", "3:")),
    ],
)
def test_what_is_wrong_with_a_range_is_said(text, words):
    with pytest.raises(InputError, match=words):
        parse_frames(text, 3, "rec")


PARTS = ("", "0", "3", "12", " 5 ", "-1", "+2", "1_0", "²", "٣", "a", "1 2", "\n", ".5")


def test_any_text_gives_frames_or_one_sentence_of_error():
    for length in range(4):
        for parts in product(PARTS, repeat=length):
            try:
                chosen = parse_frames(":".join(parts), 20, "rec")
            except InputError:
                continue
            assert 0 <= chosen[0] <= chosen[-1] < 20
            assert all(part.isascii() and "_" not in part for part in parts)
