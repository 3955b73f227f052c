"""The command line: `quadpend`, with one function for each command, whose parameters are the options.

Slow imports are inside the functions, so that `quadpend COMMAND --help` starts quickly.
"""
