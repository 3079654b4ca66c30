"""The membrane: reference surface to mesh, stiffness, gas, forward contact."""
