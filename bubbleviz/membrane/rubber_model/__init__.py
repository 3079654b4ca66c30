"""The exact rubber membrane: energy and tangent, and rigid objects pressed into it."""
