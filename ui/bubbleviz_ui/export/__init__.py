"""Exports from the window: which frames as what, to a name of the user's."""
