"""A frame looked at more closely than its result: images, probe, threshold, comparison."""
