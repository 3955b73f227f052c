"""Files, provenance and names of version 0.1. All other subpackages use these modules."""
