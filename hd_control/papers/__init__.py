"""The papers' tables and figures rebuilt beside ours: one module per paper, `rows` holds what they share."""
