"""The simulation of the paper's vehicle in PyTorch, with gradients."""
