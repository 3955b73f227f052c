"""Optimal flights of episodes that are known in advance, by direct transcription in CasADi and IPOPT."""
