"""Playback: clock, timeline, frame ranges and controls."""
