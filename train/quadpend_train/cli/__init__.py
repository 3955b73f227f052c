"""The command line: `quadpend`, with one function for each command."""
