"""The γ0 panel: from untouched frames to a sensor file, step by step."""
