"""Base layer: errors, checks of arguments, files, progress."""
