"""Cache of frames: the same frames, within the memory limit."""

from collections import Counter

import numpy as np
import pytest

from bubbleviz.recordings import CachedFrames, Frame, HeldFrames


class Counted(HeldFrames):
    """Frames whose reads are counted."""

    def __init__(self, frames):
        super().__init__(frames)
        self.reads = Counter[int]()

    def __getitem__(self, index):
        frame = super().__getitem__(index)
        self.reads[index] += 1
        return frame


def test_frames_are_read_once_until_memory_is_used_up():
    """Four of 80 bytes, of which two are kept."""
    source = Counted([Frame(k, float(k), np.full((4, 5), k + 1, np.float32)) for k in range(4)])
    kept = CachedFrames(source, limit_bytes=2 * 80)
    for _ in range(3):
        assert [kept[k].depth_m[0, 0] for k in range(len(kept))] == [1, 2, 3, 4]
    assert source.reads == {0: 1, 1: 1, 2: 3, 3: 3}
    with pytest.raises(IndexError):
        kept[4]
    kept.close()
    assert kept[0].index == 0 and source.reads[0] == 2
