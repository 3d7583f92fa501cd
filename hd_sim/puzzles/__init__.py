"""Simulated recordings that hide an effect behind a seal, and campaigns that score the diagnosis on them."""
