"""Cache of frames: the same frames, within the memory limit."""

from collections import Counter

import numpy as np
import pytest

from bubbleviz.recordings import CachedFrames, Frame


class Source:
    """Four images of 80 bytes, whose reads are counted."""

    name, times_s = "four", np.arange(4.0)

    def __init__(self):
        self.reads = Counter()

    def __len__(self):
        return 4

    def __getitem__(self, index):
        if not 0 <= index < 4:
            raise IndexError(index)
        self.reads[index] += 1
        return Frame(index, float(index), np.full((4, 5), index + 1, np.float32))

    def close(self):
        pass


def test_frames_are_read_once_until_memory_is_used_up():
    source = Source()
    kept = CachedFrames(source, limit_bytes=2 * 80)
    for _ in range(3):
        assert [kept[k].depth_m[0, 0] for k in range(len(kept))] == [1, 2, 3, 4]
    assert source.reads == {0: 1, 1: 1, 2: 3, 3: 3}
    with pytest.raises(IndexError):
        kept[4]
    kept.close()
    assert kept[0].index == 0 and source.reads[0] == 2
