"""Flight logs: reading, replay against a vehicle, and identification of a vehicle from them."""
