"""What every other module stands on: errors, checks of arguments, files, progress."""
