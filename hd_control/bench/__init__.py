"""Speed and memory of every hot path, beside peers measured in the same run (`hd bench`)."""
