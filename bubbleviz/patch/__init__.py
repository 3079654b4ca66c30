"""The contact patch: threshold, edge and separate parts."""
