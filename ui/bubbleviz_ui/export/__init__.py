"""Export of frames to files and videos."""
