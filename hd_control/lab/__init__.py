"""The workbench's arithmetic on recordings. Imports drive, record and core, nothing of the world."""
