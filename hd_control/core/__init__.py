"""Ground floor: errors, parameters, named number blocks, strict files, robot description. Imports nothing above it."""
