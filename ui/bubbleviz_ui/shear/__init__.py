"""Shear panel, and reference images of the optical flow."""
