"""End the command line at once after SIGINT or SIGTERM, and leave nothing unfinished behind."""

unfinished: set[str] = set()  # temporary files that this process is writing
