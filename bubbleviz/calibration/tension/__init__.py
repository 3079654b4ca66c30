"""The tension γ0 with its interval."""
