"""Files, parallel calls, provenance and generated parts of documents. All other subpackages use these modules."""
