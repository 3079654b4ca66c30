"""The tension γ0 with its interval, γ0 from a measured force, and the chamber's volume."""
