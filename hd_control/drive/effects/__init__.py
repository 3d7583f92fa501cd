"""One file per effect. Adding an effect is adding a file here; `hd_control.drive.library` finds it."""
