"""The command line `quadpend`."""
