"""Which physical effect a model lacks: candidates, held-out scores, search, claims, verdict."""
