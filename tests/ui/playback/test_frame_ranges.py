"""Merging, subtraction and formatting of frame ranges."""

from bubbleviz_ui.playback.frame_ranges import in_words, tidy, without


def test_ranges_are_merged_subtracted_and_formatted():
    assert tidy([(5, 9), (0, 2), (8, 12), (3, 3), (-4, 1)], 10) == ((0, 2), (5, 10))
    assert without(((0, 10), (20, 30)), 8, 25) == ((0, 8), (25, 30))
    assert without(((3, 6),), 0, 10) == ()
    assert in_words(((0, 3), (7, 8))) == "0–2, 7" and in_words(()) == "none"
