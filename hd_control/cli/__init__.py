"""The command line: one file per command, found by its name. Nothing heavy is imported before a command runs."""
