"""What a computer beside the vehicle receives and sends: samples of motion capture, commands for an autopilot."""
