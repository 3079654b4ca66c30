"""Identification: known rubber identified again and again, to see whether the intervals hold it."""
