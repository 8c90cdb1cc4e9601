"""What each physical feature of a scene contributes to its potential."""
