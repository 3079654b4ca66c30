"""The face of the library: what `import bubbleviz` offers, and the values its functions return."""
