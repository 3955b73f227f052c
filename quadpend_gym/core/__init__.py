"""What every other room uses: array types, compilation, validation, random streams, model registries."""
