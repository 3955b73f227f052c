"""Files and provenance, which every other room uses."""
