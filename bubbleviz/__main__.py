"""`python -m bubbleviz`: the command line."""

from bubbleviz.cli.command_line import main

if __name__ == "__main__":
    main(prog_name="bubbleviz")
