"""The command line: one thin function a command, which imports its work when it runs."""
