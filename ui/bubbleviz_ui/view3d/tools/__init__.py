"""Tools in the 3-D view: points of view, distance, cut, turntable, pictures."""
