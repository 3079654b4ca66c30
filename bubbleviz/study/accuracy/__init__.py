"""Accuracy: error against run time, regularisation, the linear model against exact bubbles."""
