"""Accuracy: errors over depth, run time and membranes, the detection limit, regularisation."""
