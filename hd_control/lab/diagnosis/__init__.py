"""Which physical effect is missing in a model: candidates, held-out scores, search, claims, verdict."""
