"""The pose panel: which object, where it begins, how well it fits."""
