"""The drive model: physical effects in readable numpy, one file each, and the model that lists them."""
