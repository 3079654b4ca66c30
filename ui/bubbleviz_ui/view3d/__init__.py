"""The 3-D view: VTK in Qt, the scene and its layers, and tools in it."""
