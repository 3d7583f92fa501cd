"""Pages of `docs` that are made from the code, so that they cannot grow old: faults, commands, nodes, glossary."""
