"""Traction with friction and slip, from depth and optical flow together."""
