"""3-D view: VTK in Qt, scene, layers and tools."""
