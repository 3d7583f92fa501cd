"""The project in one run: a robot hides an effect, is recorded, diagnosed, and tracks better afterwards."""
