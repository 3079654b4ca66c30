"""Solvers of the inverse problem behind one protocol."""
