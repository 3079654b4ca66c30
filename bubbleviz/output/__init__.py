"""Frames of a recording as tables, meshes, point clouds, pictures and videos for other programs."""
