"""Stability: stiff and extreme cases, each solved within its tolerance or refused."""
