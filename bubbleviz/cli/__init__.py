"""The command line: binds options to the functions of `api` and prints their results."""
