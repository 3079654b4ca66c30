"""Playback: the clock, the timeline, frame ranges and the controls."""
