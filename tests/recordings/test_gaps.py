"""Missing frames are counted, late ones are not."""

import numpy as np
import pytest
from bagmaker import HEIGHT, PERIOD, START, WIDTH, BagMaker, depth_image, fill, pressure_at
from hypothesis import given, strategies as st

from bubbleviz.api.frames import info
from bubbleviz.recordings import find_gaps
from tests.program import facts_of, output_of


@given(
    st.integers(30, 200),
    st.sets(st.integers(3, 197), max_size=8),
    st.floats(0.0, 0.12),
    st.integers(0, 2**31),
    st.floats(1e-3, 1.0),
)
def test_dropped_frames_are_counted_despite_jitter(total, dropped, jitter, seed, period):
    kept = np.array([k for k in range(total) if k not in dropped or k >= total - 3])
    noise = np.random.default_rng(seed).uniform(-jitter, jitter, total)
    gaps = find_gaps((kept + noise[kept]) * period)
    assert sum(gap.missing for gap in gaps) == total - len(kept)
    expected = [(k, int(step) - 1) for k, step in enumerate(np.diff(kept)) if step > 1]
    assert [(gap.after_frame, gap.missing) for gap in gaps] == expected


def test_one_late_frame_is_not_a_gap():
    times = np.arange(20) / 30.0
    times[9] += 0.6 / 30.0
    assert find_gaps(times) == ()


@pytest.mark.parametrize("times", [[0.0], [0.0, 0.0, 0.0], [0.0, 1.0]])
def test_too_few_frames_for_gaps(times):
    assert find_gaps(np.array(times)) == ()


def test_info_of_a_recording(tmp_path):
    bag = fill(BagMaker("mcap file"))
    for k in (9, 10):  # frames 6, 7 and 8 are missing
        bag.image(START + k * PERIOD, depth_image(k))
    path = bag.write(tmp_path)
    facts = info(path)
    assert (facts.frames, facts.gaps) == (8, 3)
    assert [(g.after_frame, g.missing) for g in facts.gap_positions] == [(5, 3)]
    assert facts.rate_hz == pytest.approx(1e9 / PERIOD)
    assert facts.duration_s == pytest.approx(10 * PERIOD * 1e-9)
    assert facts.size_bytes == path.stat().st_size
    assert (facts.width, facts.height, facts.encoding) == (WIDTH, HEIGHT, "32FC1")
    assert facts.gas_pressure_pa == pytest.approx(
        (pressure_at(START - PERIOD // 2), pressure_at(START + 11 * PERIOD // 2))
    )
    assert facts.wrench
    counts = {topic.name: topic.count for topic in facts.topics}
    assert counts == {"/cam/depth/image": 8, "/cam/depth/camera_info": 6, "/gas": 7, "/wrench": 6}


def test_json_and_text_agree(press):
    data = facts_of("info", press)
    assert data["frames"] == 6
    assert data["gaps"] == 0
    assert {topic["name"] for topic in data["topics"]} >= {"/gas", "/wrench"}
    assert data["intrinsics"]["fx"] == 30.0
    text = output_of("info", press)
    for part in ("6 in 0.167 s, 30.00 Hz", "no missing frames", "32 × 24 pixels", "kPa absolute"):
        assert part in text


def test_real_recording_has_no_gaps(punyo_press):
    """Its camera is late by up to half a period, yet its frame numbers are complete."""
    facts = info(punyo_press)
    assert (facts.frames, facts.gaps) == (90, 0)
    assert facts.rate_hz == pytest.approx(30.0, rel=0.02)
